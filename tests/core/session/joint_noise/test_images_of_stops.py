"""Images of one stop say of the robot what one visit says: its joints stopped once."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from core.kinematics import joint_jacobian
from core.session import ImageObservation, MeasuredPose, SessionData, SessionEstimate, assess_joint_noise
from core.session.joint_noise import NORMAL_FACTOR
from core.session.robot.robot_poses import poses_of_estimate
from core.simulation.arm import KR5_ARC
from core.targets.specification import TargetSpec
from tests.support.simulation.robots.repeated_poses import JOINT_SIGMA, repeated_poses

BOARD = TargetSpec("chessboard", 9, 6, 12.0, pitch_standard_uncertainty_mm=1e-5)
NOISE = np.diag(np.repeat([0.01, 5e-5], 3) ** 2)
NO_LIMITS = np.array([[-math.inf] * 6, [math.inf] * 6])


def seen_in_bursts(
    seed: int, *, poses: int, stops: int, burst: int, indexed: bool = True
) -> tuple[SessionData, SessionEstimate]:
    """A camera's poses of so many stops of so many images; the robot does not move within a stop."""
    _, visits, _ = repeated_poses(seed, poses=poses, visits=stops, instrument=(0.0, 0.0), stated=False)
    assert visits.rotations is not None
    rng = np.random.default_rng(seed + 1)
    found = []
    for stop, pose_id in enumerate(visits.labels):
        for index in range(1, burst + 1):
            name = f"{pose_id}-{stop}-{index}"
            angles = np.degrees(visits.joint_angles[stop]).tolist()
            image = ImageObservation(
                *(name, pose_id, stop % stops + 1, name, 0, "default", angles, 2448, 2050),
                burst=index if indexed else None,
            )
            off = rng.normal(0.0, 0.01, 3)
            found.append(
                MeasuredPose(
                    *(name, pose_id, image.cycle, angles, visits.positions_mm[stop] + off),
                    *(visits.rotations[stop], NOISE, NOISE, np.zeros((6, 1))),
                    image=image,
                )
            )
    images = tuple(pose.image for pose in found if pose.image is not None)
    data = SessionData((BOARD,), ("board",), images, nominal=KR5_ARC)
    return data, SessionEstimate("given", (), tuple(found), {}, (), {}, frozenset(), frozenset())


def test_images_of_a_stop_are_one_pose_of_the_robot() -> None:
    data, estimate = seen_in_bursts(1, poses=4, stops=3, burst=2)
    gathered = poses_of_estimate(data, estimate, nominal_prints=True)
    assert len(gathered.poses) == 4 * 3
    assert gathered.rows.tolist() == list(range(4 * 3 * 2))
    means = [np.mean([one.position_mm for one in estimate.poses[k : k + 2]], axis=0) for k in range(0, 24, 2)]
    np.testing.assert_allclose(gathered.poses.positions_mm, means)
    assert gathered.poses.covariance is not None
    np.testing.assert_allclose(gathered.poses.covariance, np.broadcast_to(NOISE / 2.0, (12, 6, 6)))
    apart, found = seen_in_bursts(1, poses=4, stops=3, burst=2, indexed=False)
    assert len(poses_of_estimate(apart, found, nominal_prints=True).poses) == 24


def test_targets_seen_at_one_stop_stay_together() -> None:
    """Of the second target only the second image serves: it is of the same stop all the same."""
    data, estimate = seen_in_bursts(2, poses=4, stops=2, burst=2)
    others = tuple(
        replace(pose, measurement_id=f"{pose.measurement_id}-b", frame=1)
        for pose in estimate.poses
        if pose.image is not None and pose.image.burst == 2
    )
    both = replace(estimate, poses=(*estimate.poses, *others))
    gathered = poses_of_estimate(replace(data, targets=(BOARD, BOARD)), both, nominal_prints=True).poses
    assert gathered.image is not None
    assert gathered.targets.tolist() == [0] * 8 + [1] * 8
    np.testing.assert_array_equal(gathered.image[:8], gathered.image[8:])


def test_images_of_different_cameras_at_one_stop_stay_apart() -> None:
    data, estimate = seen_in_bursts(3, poses=4, stops=2, burst=2)
    found = tuple(
        replace(pose, image=replace(pose.image, focus_group=f"camera {pose.image.burst}"))
        for pose in estimate.poses
        if pose.image is not None
    )
    assert len(poses_of_estimate(data, replace(estimate, poses=found), nominal_prints=True).poses) == 16


def test_intervals_of_joint_noise_from_stops_of_three_images_hold_the_truth() -> None:
    """Taken for visits of their own, images held 63 % of the joints, and the noise was said to be 8 % smaller."""
    held, ratios = [], []
    runs = 12
    for seed in range(runs):
        data, estimate = seen_in_bursts(300 + seed, poses=10, stops=5, burst=3)
        found = assess_joint_noise(data, estimate, limits=NO_LIMITS)
        assert {pose.visits for pose in found.poses} == {5}
        low, high = found.noise.interval(NORMAL_FACTOR)
        held.append(np.mean((low[:6] <= JOINT_SIGMA) & (high[:6] >= JOINT_SIGMA)))
        J = joint_jacobian(found.scatters.arm, found.scatters.joint_angles, np.zeros(10, dtype=np.intp))[
            :, :3
        ]
        true, predicted = (
            np.einsum("kmj,j->k", J**2, v) for v in (JOINT_SIGMA**2, found.noise.variances[:6])
        )
        ratios.append(float(np.mean(np.sqrt(predicted / true))))
    # Of 72 joints three standard deviations below .95; with so few visits a little less than that is held.
    assert np.mean(held) > 0.95 - 3.0 * math.sqrt(0.95 * 0.05 / 72) - 0.03
    assert np.mean(ratios) > 0.96


def test_a_shake_within_stops_is_not_taken_for_the_robots_scatter() -> None:
    """Ten poses of eight stops of two images, four sessions; each image shakes by .1 mm, which no model of points sees.

    Taken for the robot's it made the predicted scatter 1.7 times the true one.
    """
    ratios = []
    for seed in range(500, 504):
        data, still = seen_in_bursts(seed, poses=10, stops=8, burst=2)
        rng = np.random.default_rng(seed + 999)
        shaken = tuple(
            replace(pose, position_mm=pose.position_mm + rng.normal(0.0, 0.1, 3)) for pose in still.poses
        )
        found = assess_joint_noise(data, replace(still, poses=shaken), limits=NO_LIMITS)
        assert [one.code for one in found.warnings].count("burst_scatter_above_model") == 1
        low, _ = found.noise.interval(NORMAL_FACTOR)
        assert low[6] == 0.0  # nothing remains for certain beyond the joints' noise
        J = joint_jacobian(found.scatters.arm, found.scatters.joint_angles, np.zeros(10, dtype=np.intp))[
            :, :3
        ]
        true, predicted = (
            np.einsum("kmj,j->k", J**2, v) for v in (JOINT_SIGMA**2, found.noise.variances[:6])
        )
        ratios.append(float(np.mean(np.sqrt((predicted + 3.0 * found.noise.variances[6]) / true))))
    assert 0.9 < np.mean(ratios) < 1.15
