"""Arms drawn as built, swept ±40° in 11 steps a joint, identified from axes: errors no larger than a study reached,
stated uncertainties true.

The study's rms errors (mm, °) of a KR5-like arm; its robot's repeatability is taken as RP_l .1 mm by ISO 9283 (each
coordinate .1/3.616 mm) with .005° about each axis. One arm's 18 parameters are correlated, so that the share of them
within their 95 % interval scatters from arm to arm with a standard deviation of some .07.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from core.geometry.se3 import invert, so3_exp, so3_log
from core.kinematics.circle_point_analysis.common_normals import axes_of, reparametrise
from core.kinematics.circle_point_analysis.covariance import ArcTree
from core.kinematics.circle_point_analysis.identification import AxesIdentification, identify_from_axes
from core.kinematics.joint_axes.axis_fit import fit_axes
from core.kinematics.sweeps import JOINT_TOLERANCE, find_sweeps
from core.simulation import KR5_ARC, KR5_ARC_HOME, Arm, kr5_arc, sweep_angles
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

ROBOT = Repeatability(0.1 / 3.616, math.radians(0.005))
SPREAD_OF_ARMS = 0.07
ARMS = 6
JOINTS = Repeatability(joint_rad=7e-5)
""".1 mm at the end of the stretched arm, from each joint: noise that follows the arm's own levers."""
SWEEPS = sweep_angles(KR5_ARC_HOME)
# The simulated view's camera position is off by .88 mm per image at this noise.
PER_IMAGE_PX = 0.0425

pytestmark = pytest.mark.slow


@functools.cache
def run(
    method: str, estimator: str, robot: Repeatability | None
) -> tuple[tuple[Arm, AxesIdentification], ...]:
    found = []
    sigma_px = PER_IMAGE_PX if estimator == "per_image" else 0.05
    for trial in range(ARMS):
        rng = np.random.default_rng([trial, 77])
        arm = kr5_arc(rng)
        poses = measure_poses(arm, SWEEPS, rng, estimator=estimator, robot=robot, sigma_px=sigma_px)
        found.append((arm, identify_from_axes(poses, KR5_ARC, method)))
    return tuple(found)


def off(arm: Arm, found: AxesIdentification) -> np.ndarray:
    true = reparametrise(arm.chain, [j.parallel_to_next for j in found.joints], KR5_ARC).as_array()
    return np.where(found.identifiable, found.chain.as_array() - true, np.nan)


def rms(runs: Sequence[tuple[Arm, AxesIdentification]]) -> tuple[float, float]:
    errors = np.array([off(arm, found) for arm, found in runs])
    length = math.sqrt(float(np.nanmean(errors[:, :, [0, 2]] ** 2)))
    return length, math.degrees(math.sqrt(float(np.nanmean(errors[:, :, [1, 3, 4]] ** 2))))


def covered(runs: Sequence[tuple[Arm, AxesIdentification]]) -> float:
    ratio = [off(a, f) / np.sqrt(np.maximum(np.diag(f.covariance), 1e-300)).reshape(-1, 5) for a, f in runs]
    finite = np.array(ratio)[np.isfinite(np.array(ratio))]
    return float(np.mean(np.abs(finite) < 1.96))


@pytest.mark.parametrize(
    ("method", "estimator", "robot", "limit_mm", "limit_deg"),
    [
        ("cpa", "per_image", None, 5.3, 0.92),
        ("screw", "per_image", None, 0.66, 0.042),
        ("combined", "per_image", None, 0.063, 0.0026),
        ("cpa", "pooled", None, 0.066, 0.012),
        ("combined", "pooled", None, 0.008, 0.0005),
        ("screw", "pooled", ROBOT, 0.055, 0.0076),
        ("combined", "pooled", ROBOT, 0.045, 0.0055),
    ],
)
def test_errors_are_no_larger_than_the_studys(
    method: str, estimator: str, robot: Repeatability | None, limit_mm: float, limit_deg: float
) -> None:
    length, angle = rms(run(method, estimator, robot))
    # Six arms of some 18 parameters: an rms good to some 15 %. A circle determines its axis as its radius allows: the
    # camera goes round axis 4 at 121 mm here, which makes a quarter more than the study had; the fit is at its bound
    # all the same, as true intervals show.
    share = 1.5 if method == "cpa" else 1.2
    assert length < share * limit_mm
    assert angle < share * limit_deg


def test_stated_intervals_of_parameters_are_true() -> None:
    """Of 150 arms a case, measured once: .951 pooled, .939 per image, .951 with the robot's, .945 with its joints'."""
    cases = [("pooled", None), ("pooled", ROBOT), ("per_image", None), ("pooled", JOINTS)]
    runs = [pair for estimator, robot in cases for pair in run("combined", estimator, robot)]
    bound = 3.5 * SPREAD_OF_ARMS / math.sqrt(len(runs))
    assert 0.95 - bound < covered(runs) < 0.95 + bound


@pytest.mark.parametrize("method", ["cpa", "screw", "combined"])
def test_covariance_is_true(method: str) -> None:
    """Normalised errors of each arc's axis, four numbers, have a mean square of 1; intervals of parameters are true."""
    squares = []
    runs = run(method, "pooled", ROBOT)
    assert covered(runs) > 0.95 - 3.5 * SPREAD_OF_ARMS / math.sqrt(len(runs))
    for arm, found in runs:
        true = axes_of(arm.chain, KR5_ARC_HOME, arm.T_target_base[0])
        for i, (arc, basis) in enumerate(zip(found.fits.arcs, found.fits.bases, strict=True)):
            n = true.directions[arc.sweep.joint]
            out = true.points[arc.sweep.joint] - arc.point_mm
            out = out - n * (out @ arc.direction) / (n @ arc.direction)
            error = np.concatenate([basis.T @ out, basis.T @ np.cross(arc.direction, n)])
            block = found.fits.covariance[4 * i : 4 * i + 4, 4 * i : 4 * i + 4]
            squares.append(float(error @ np.linalg.solve(block, error)) / 4.0)
    # 36 axes of four numbers: √(2/144) = .12 of the mean; homes are shared, which adds a little; 3.5 of these.
    assert 0.55 < np.mean(squares) < 1.5


def test_what_all_poses_share_is_estimated_with_the_arcs() -> None:
    """The lens is as good as one from few images, so that its error dominates: without it, answers are further off."""
    careful, careless = [], []
    for trial in range(4):
        rng = np.random.default_rng([trial, 78])
        arm = kr5_arc(rng)
        poses = measure_poses(arm, SWEEPS, rng)
        assert poses.common is not None
        assert poses.rotations is not None
        # Six times the lens's error: that of a lens from a few images.
        extra = 5.0 * poses.common @ rng.normal(0.0, 1.0, poses.common.shape[2])
        shifted = replace(
            poses,
            positions_mm=poses.positions_mm + extra[:, :3],
            rotations=np.array([so3_exp(w) for w in extra[:, 3:]]) @ poses.rotations,
            common=math.sqrt(26.0) * poses.common,
        )
        careful.append((arm, identify_from_axes(shifted, KR5_ARC)))
        careless.append((arm, identify_from_axes(replace(shifted, common=None), KR5_ARC)))
    assert covered(careful) > 0.95 - 3.5 * SPREAD_OF_ARMS / math.sqrt(4)
    assert rms(careful)[0] < rms(careless)[0]


def test_how_targets_lie_by_arcs_on_each_has_a_true_covariance() -> None:
    """No image shows both targets: joints 1 and 2 are swept before either, at other settings of the joints after."""
    away = KR5_ARC_HOME + np.radians([0.0, 0.0, -20.0, 5.0, 30.0, 0.0])
    q = np.concatenate([sweep_angles(home, joints=[0, 1], steps=9) for home in (KR5_ARC_HOME, away)])
    target = np.repeat([0, 1], len(q) // 2)
    squares = []
    for trial in range(16):
        rng = np.random.default_rng([trial, 79])
        arm = kr5_arc(rng)
        poses = measure_poses(arm, q, rng, robot=ROBOT, target=target)
        fits = fit_axes(poses, find_sweeps(poses))
        link = ArcTree.grown(fits, KR5_ARC_HOME, poses, 2.0 * JOINT_TOLERANCE).links[1]
        assert link.covariance is not None
        T = arm.T_target_base[0] @ invert(arm.T_target_base[1])
        turn = so3_log(T[:3, :3] @ link.T_first_target[:3, :3].T)
        error = np.concatenate([T[:3, 3] - link.T_first_target[:3, 3], turn])
        squares.append(float(error @ np.linalg.solve(link.covariance, error)) / 6.0)
    # 16 links of six numbers: √(2/96) = .14 of the mean; three and a half of that.
    assert np.mean(squares) == pytest.approx(1.0, abs=0.5)
