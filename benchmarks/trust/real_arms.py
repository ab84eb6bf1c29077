"""Arms with gears and bending: what identification predicts, and whether what it states is true.

Real arms come from the data folder (`GRIDPOSE_TEST_DATA`, as in tests/reference); simulated ones have harmonics of
gears in every joint, compliance in joints 2 and 3 by masses that the model does not know, and scatter.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.table import Row
from core.kinematics import (
    JOINT_PARAMETERS,
    Blocking,
    Identification,
    ModelChoice,
    PoseData,
    forward,
    identify,
)
from core.kinematics.global_fit import blocks_of, observations_of, placed
from core.simulation import KR5_ARC
from tests.support.simulation.robots.arms import UR10, predicted_within_95, predictions
from tests.support.simulation.robots.real_arms import RealArm, angles_within_limits, measured, real_arm
from tests.support.simulation.robots.ur10_tracker import tracked
from tests.support.simulation.simulated_poses import measure_poses

MAX_LENGTH_MM, MAX_ANGLE = 3.0, math.radians(0.25)
"""A parameter that is more uncertain is not identifiable (METHOD: real arms), whichever model states it."""
OUTER_BLOCK_THINNING = 3
ANGLES = [k for k, name in enumerate(JOINT_PARAMETERS) if name.endswith("_rad")]


def trust_rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    """Yield the rows of real arms, then those of simulated ones."""
    series = list(_series())
    if not series:
        yield Row(
            "real arms before a laser tracker", "no data", note="set GRIDPOSE_TEST_DATA to their folder"
        )
    for name, poses in series:
        yield from _real_rows(name, poses, quick)
    yield from _simulated_rows(seeds, quick)
    yield from _speed_rows()


def _series() -> Iterator[tuple[str, PoseData]]:
    folder = Path(os.environ.get("GRIDPOSE_TEST_DATA", Path(__file__).parents[3] / "shared" / "data"))
    for of_series in sorted((folder / "ur10_lasertracker").glob("Series_*")):
        yield f"UR10 {of_series.name.replace('_', ' ')}", tracked(folder, of_series.name)


def _real_rows(name: str, poses: PoseData, quick: bool) -> Iterator[Row]:
    found = identify(poses, UR10, model=ModelChoice.AUTO)
    validation = found.validation
    assert validation is not None
    assert validation.nominal is not None
    by = {block.blocking: block for block in validation.blocks}
    clusters = by[Blocking.CLUSTERS]
    assert clusters.nominal is not None
    note = (
        f"{len(poses)} poses; nominal {validation.nominal.position_rms_mm:.2f} mm with fitted base and tool"
    )
    yield Row.at_most(
        f"{name}: held-out position error ÷ nominal, random folds",
        validation.identified.position_rms_mm / validation.nominal.position_rms_mm,
        0.13,
        note=note,
    )
    yield Row.at_most(
        f"{name}: held-out position error ÷ nominal, clusters of joint space",
        clusters.identified.position_rms_mm / clusters.nominal.position_rms_mm,
        0.2,
        note=f"{clusters.blocks} clusters; nominal {clusters.nominal.position_rms_mm:.2f} mm",
    )
    yield from _half_rows(name, poses)
    if not quick:
        yield from _block_rows(name, poses.take(np.arange(0, len(poses), OUTER_BLOCK_THINNING)))


def _half_rows(name: str, poses: PoseData) -> Iterator[Row]:
    """Yield how far the parameters of two halves are from one another, in stated uncertainties."""
    q = poses.joint_angles
    arm = placed(UR10.as_array(), forward(UR10, q), observations_of(poses))
    keys = {
        "elbow": q[:, 2],
        "height": (forward(UR10, q) @ arm.T_flange_camera)[:, 2, 3],
        "time": np.arange(len(q), dtype=np.float64),
        "random": np.random.default_rng(1).permutation(len(q)).astype(np.float64),
    }
    for key, values in keys.items():
        order = np.argsort(values, kind="stable")
        halves = [poses.take(np.sort(part)) for part in np.array_split(order, 2)]
        of_model = {
            model: _disagreement(*(identify(half, UR10, folds=0, model=model) for half in halves))
            for model in (ModelChoice.EXTENDED, ModelChoice.DH)
        }
        yield Row.at_most(
            f"{name}: rms z of DH between halves by {key}",
            of_model[ModelChoice.EXTENDED],
            1.5,
            note=f"model=dh: {of_model[ModelChoice.DH]:.2f}",
        )


def _disagreement(one: Identification, other: Identification) -> float:
    a, b = one.chain.as_array(), other.chain.as_array()
    u, v = _stated(one), _stated(other)
    z = (a - b) / np.hypot(u, v)
    return math.sqrt(float(np.nanmean(z**2)))


def _stated(found: Identification) -> np.ndarray:
    """Return standard uncertainties; NaN where a parameter is not identifiable."""
    u = np.array(
        [[j.standard_uncertainty[name] or math.nan for name in JOINT_PARAMETERS] for j in found.joints]
    )
    limit = np.full(u.shape, MAX_LENGTH_MM)
    limit[:, ANGLES] = MAX_ANGLE
    return np.where(u <= limit, u, np.nan)


def _block_rows(name: str, poses: PoseData) -> Iterator[Row]:
    """Yield the coverage of predicted positions at blocks that had no part in anything."""
    arm = placed(UR10.as_array(), forward(UR10, poses.joint_angles), observations_of(poses))
    for blocking, block in blocks_of(arm, poses.joint_angles).items():
        inside = predicted_within_95(poses, UR10, block)
        yield Row.at_least(
            f"{name}: coverage of the predicted position at held-out blocks by {blocking}",
            100.0 * float(np.mean(inside)),
            90.0,
            "%",
            f"{len(poses)} poses, {len(np.unique(block))} blocks, each predicted by the others",
        )


def _drawn(seed: int, trial: int, count: int, *, perfect: bool) -> tuple[RealArm, np.ndarray, PoseData]:
    rng = np.random.default_rng([seed, trial, count])
    real = real_arm(rng, perfect=perfect)
    q = angles_within_limits(rng, count)
    return real, q, measured(real, q, rng)


def _simulated_rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    trials = 2 if quick else 5
    for count in (60, 120):
        worst = []
        for seed in seeds:
            for trial in range(trials):
                real, q, poses = _drawn(seed, trial, count, perfect=True)
                auto = identify(poses, KR5_ARC, model=ModelChoice.AUTO)
                worst.append(_true_error(real, auto) / _true_error(real, identify(poses, KR5_ARC)))
        yield Row.at_most(
            f"perfect robot, {count} poses: true position error of auto ÷ that of dh",
            math.sqrt(float(np.mean(np.square(worst)))),
            1.02,
            note=f"{len(worst)} arms; the largest {max(worst):.3f}",
        )
    for count in (40, 60, 120):
        ratios: dict[ModelChoice, list[np.ndarray]] = {ModelChoice.AUTO: [], ModelChoice.DH: []}
        predicted, gain = [], []
        for seed in seeds:
            for trial in range(trials):
                real, q, poses = _drawn(seed, trial, count, perfect=False)
                truth = _truth(real, q)
                errors = {}
                for model, of_model in ratios.items():
                    found = identify(poses, KR5_ARC, model=model)
                    of_model.append((found.chain.as_array() - truth) / _stated(found))
                    errors[model] = _true_error(real, found)
                    if found.error_model is not None:
                        predicted.append(_inside(real, found))
                gain.append(errors[ModelChoice.AUTO] / errors[ModelChoice.DH])
        inside = {model: _covered(of_model) for model, of_model in ratios.items()}
        arms = f"{len(gain)} arms"
        yield Row.at_least(
            f"gears and compliance, {count} poses: DH within 95 % intervals",
            inside[ModelChoice.AUTO],
            85.0,
            "%",
            f"{arms}; model=dh: {inside[ModelChoice.DH]:.0f} %",
        )
        yield Row.at_least(
            f"gears and compliance, {count} poses: predicted positions within 95 % intervals",
            100.0 * float(np.mean(predicted)),
            90.0,
            "%",
            arms,
        )
        yield Row.context(
            f"gears and compliance, {count} poses: true position error of auto ÷ that of dh",
            math.sqrt(float(np.mean(np.square(gain)))),
            note=f"{arms}; the largest {max(gain):.2f}",
        )


def _truth(real: RealArm, q: np.ndarray) -> np.ndarray:
    """Return the chain with what is not identifiable at the nominal: what exact poses without gears give."""
    exact = measure_poses(real.arm, q, np.random.default_rng(0), estimator="exact")
    return identify(exact, KR5_ARC, folds=0).chain.as_array()


def _covered(ratios: Sequence[np.ndarray]) -> float:
    z = np.concatenate([ratio[np.isfinite(ratio)] for ratio in ratios])
    return 100.0 * float(np.mean(np.abs(z) < 1.96))


def _fresh(real: RealArm) -> tuple[np.ndarray, np.ndarray]:
    q = angles_within_limits(np.random.default_rng(99), 300)
    return q, real.arm.camera_poses(real.turned(q))[:, :3, 3]


def _true_error(real: RealArm, found: Identification) -> float:
    """Return the rms distance of predicted from true positions at fresh configurations."""
    q, true = _fresh(real)
    if found.error_model is not None:
        T, _ = predictions(found.error_model, q)
    else:
        T = found.T_target_base[0] @ forward(found.chain, q) @ found.T_flange_camera
    return math.sqrt(float(np.mean(np.sum((T[:, :3, 3] - true) ** 2, axis=1))))


def _inside(real: RealArm, found: Identification) -> float:
    """Return the share of fresh measurements, noise included, within their intervals."""
    rng = np.random.default_rng(98)
    q = angles_within_limits(rng, 300)
    assert found.error_model is not None
    predicted, deviations = predictions(found.error_model, q)
    off = (measured(real, q, rng).positions_mm - predicted[:, :3, 3]).T
    return float(np.mean(np.abs(off) <= 1.96 * deviations[:3]))


def _speed_rows() -> Iterator[Row]:
    for count in (400, 1000):
        _, _, poses = _drawn(0, 0, count, perfect=False)
        times = []
        for _ in range(4):
            begun = time.process_time()  # of this process alone: the linear algebra has one thread
            identify(poses, KR5_ARC, folds=0, model=ModelChoice.AUTO)
            times.append(time.process_time() - begun)
        yield Row.at_most(
            f"fit of chain and terms, {count:,} poses",
            float(np.median(times[1:])),
            3.0,
            "s",
            "processor time, one thread",
        )
