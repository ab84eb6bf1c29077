"""What tests of identification share: arms, and the truth in the coordinates that poses determine."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Int

from core.kinematics.correction.model import attained_poses, predicted_variances
from core.kinematics.dh import JOINT_PARAMETERS, Chain
from core.kinematics.error_model import ErrorModel
from core.kinematics.identification import Identification, ModelChoice, identify
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, Arm, free_angles, kr5_arc, sweep_angles
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

UR10 = Chain.from_rows(
    [
        (0.0, 90.0, 127.3, 0.0),
        (-612.0, 0.0, 0.0, 0.0),
        (-572.3, 0.0, 0.0, 0.0),
        (0.0, 90.0, 163.941, 0.0),
        (0.0, -90.0, 115.7, 0.0),
        (0.0, 0.0, 92.2, 0.0),
    ]
)
SEVEN_JOINTS = Chain.from_rows(
    [
        (0.0, -90.0, 360.0, 0.0),
        (0.0, 90.0, 0.0, 0.0),
        (0.0, 90.0, 420.0, 0.0),
        (0.0, -90.0, 0.0, 0.0),
        (0.0, -90.0, 400.0, 0.0),
        (0.0, 90.0, 0.0, 0.0),
        (0.0, 0.0, 126.0, 0.0),
    ]
)


def angles(rng: np.random.Generator, *, free: int = 30) -> np.ndarray:
    """Sweeps of every joint of a KR5 Arc, ±40° in 11 steps, and free poses about the same home."""
    return np.vstack([sweep_angles(KR5_ARC_HOME), free_angles(rng, KR5_ARC_HOME, free)])


def free_poses(seed: int = 1, half_range: float = math.radians(40.0)) -> PoseData:
    """Sixty poses of a KR5 Arc, drawn about its home; all joints move at once."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    q = free_angles(rng, KR5_ARC_HOME, 60, half_range=half_range)
    return measure_poses(arm, q, rng, estimator="given", robot=Repeatability(0.1, 1e-4))


def identifiable_truth(arm: Arm, joint_angles: np.ndarray, nominal: Chain = KR5_ARC) -> np.ndarray:
    """The arm's parameters that exact poses give; what cannot be identified has the nominal's values."""
    exact = measure_poses(arm, joint_angles, np.random.default_rng(0), estimator="exact")
    return identify(exact, nominal, folds=0).chain.as_array()


def stated(found: Identification) -> np.ndarray:
    """Standard uncertainties, a row per joint; NaN where a parameter is not identifiable."""
    rows = [
        [j.standard_uncertainty[name] if j.identifiable[name] else np.nan for name in JOINT_PARAMETERS]
        for j in found.joints
    ]
    return np.array(rows, dtype=np.float64)


def predictions(
    model: ErrorModel, joint_angles: Float[np.ndarray, "n j"]
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, "m n"]]:
    """Return the poses before the first target that a model predicts, from whichever side joints come, and the standard
    deviations (mm, then rad) of one more measurement from them.
    """
    stated = predicted_variances(model, model.level, joint_angles)
    factor = np.repeat(model.growth, 3)[:, None]
    return attained_poses(model, model.level, joint_angles), factor * np.sqrt(stated)


def predicted_within_95(
    poses: PoseData, nominal: Chain, block: Int[np.ndarray, " n"], largest: int | None = None
) -> Bool[np.ndarray, "3 n"]:
    """Return which positions, of one block after another, are within the 95 % intervals that all other blocks give.

    `largest` is how many blocks are looked at, those of most poses; None for all.
    """
    inside = []
    names, sizes = np.unique(block, return_counts=True)
    for one in names[np.argsort(-sizes, kind="stable")[:largest]]:
        rest = poses.take(np.flatnonzero(block != one))
        model = identify(rest, nominal, model=ModelChoice.AUTO).error_model
        assert model is not None
        out = poses.take(np.flatnonzero(block == one))
        predicted, deviations = predictions(model, out.joint_angles)
        off = (out.positions_mm - predicted[:, :3, 3]).T
        inside.append(np.abs(off) <= 1.96 * deviations[:3])
    return np.concatenate(inside, axis=1)
