"""Noise of the joints is found again from the scatter of repeated poses, with intervals that hold."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.errors import MotionInsufficient, TooFewPoses
from core.kinematics import fit_joint_noise, gather_scatters, joint_jacobian
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import KR5_ARC
from tests.support.simulation.robots.repeated_poses import JOINT_SIGMA, repeated_poses


def test_the_jacobian_is_that_of_the_poses() -> None:
    _, data, q = repeated_poses(1, poses=5, visits=3)
    seen = gather_scatters(data, KR5_ARC)
    arm = seen.arm
    step = 1e-6
    J = joint_jacobian(arm, q, np.zeros(len(q), dtype=np.intp))
    for joint in range(6):
        moved = q + step * np.eye(6)[joint]
        T = [arm.T_target_base[0] @ t @ arm.T_flange_camera for t in _forward(moved)]
        T0 = [arm.T_target_base[0] @ t @ arm.T_flange_camera for t in _forward(q)]
        change = np.array([(a[:3, 3] - b[:3, 3]) / step for a, b in zip(T, T0, strict=True)])
        np.testing.assert_allclose(J[:, :3, joint], change, atol=2e-3)
        turn = [(a[:3, :3] @ b[:3, :3].T - np.eye(3)) / step for a, b in zip(T, T0, strict=True)]
        w = np.array([[t[2, 1], t[0, 2], t[1, 0]] for t in turn])
        np.testing.assert_allclose(J[:, 3:, joint] / arm.reach_mm, w, atol=1e-5)


def _forward(q: np.ndarray) -> np.ndarray:
    from core.kinematics import forward

    return forward(KR5_ARC, q)


def test_known_noise_is_found_and_the_instruments_taken_off() -> None:
    _, data, _ = repeated_poses(2)
    noise = fit_joint_noise(gather_scatters(data, KR5_ARC))
    assert noise.identifiable.all()
    # 348 degrees of freedom over 6 joints: some 5 to 10 % of each.
    np.testing.assert_allclose(noise.deviations[:6], JOINT_SIGMA, rtol=0.35)
    low, high = noise.interval(3.0)
    assert np.all(low[:6] < JOINT_SIGMA)
    assert np.all(high[:6] > JOINT_SIGMA)
    assert noise.deviations[6] < 0.005  # mm, of an instrument of 0.01 mm
    assert not noise.outliers.any()


def test_what_no_joint_explains_is_the_remaining_scatter() -> None:
    _, data, _ = repeated_poses(3, remaining_mm=0.05)
    noise = fit_joint_noise(gather_scatters(data, KR5_ARC))
    assert noise.deviations[6] == pytest.approx(0.05, rel=0.15)
    # Of an instrument that states nothing, its own noise is part of it.
    _, data, _ = repeated_poses(3, instrument=(0.03, 1e-5), stated=False)
    unstated = fit_joint_noise(gather_scatters(data, KR5_ARC))
    assert unstated.deviations[6] == pytest.approx(0.03, rel=0.15)


def test_no_variance_is_below_zero_where_a_joint_is_still() -> None:
    still = JOINT_SIGMA * [1.0, 1.0, 0.0, 1.0, 0.0, 1.0]
    _, data, _ = repeated_poses(4, joint_sigma=still)
    noise = fit_joint_noise(gather_scatters(data, KR5_ARC))
    assert np.all(noise.variances >= 0.0)
    low, high = noise.interval(2.0)
    assert np.all(low[[2, 4]] == 0.0)
    assert np.all(high[[2, 4]] < JOINT_SIGMA[[2, 4]])


def test_positions_alone_say_nothing_of_a_joint_through_the_point() -> None:
    _, data, _ = repeated_poses(5, rotations=False)
    seen = gather_scatters(data, KR5_ARC)
    assert seen.jacobian.shape[1] == 3
    noise = fit_joint_noise(seen)
    assert len(noise.variances) == 7
    np.testing.assert_allclose(noise.deviations[:3], JOINT_SIGMA[:3], rtol=0.35)


def test_a_gross_visit_is_excluded_and_the_noise_stays() -> None:
    _, data, _ = repeated_poses(6)
    clean = fit_joint_noise(gather_scatters(data, KR5_ARC))
    positions = data.positions_mm.copy()
    positions[40] += [3.0, -2.0, 1.0]
    assert data.rotations is not None
    spoilt = PoseData(data.joint_angles, positions, data.rotations, data.covariance, labels=data.labels)
    noise = fit_joint_noise(gather_scatters(spoilt, KR5_ARC))
    assert np.flatnonzero(noise.outliers).tolist() == [40]
    np.testing.assert_allclose(noise.deviations[:6], clean.deviations[:6], rtol=0.05)


def _spoilt(data: PoseData, *visits: int) -> PoseData:
    """Return poses of which some visits are 3 mm off."""
    positions = data.positions_mm.copy()
    positions[list(visits)] += [2.0, -2.0, 1.0]
    return PoseData(data.joint_angles, positions, data.rotations, data.covariance, labels=data.labels)


def test_of_two_visits_that_disagree_neither_counts() -> None:
    _, data, _ = repeated_poses(16, poses=40, visits=2)
    clean = fit_joint_noise(gather_scatters(data, KR5_ARC))
    assert not clean.outliers.any()
    noise = fit_joint_noise(gather_scatters(_spoilt(data, 7, 20), KR5_ARC))
    assert np.flatnonzero(noise.outliers).tolist() == [6, 7, 20, 21]
    # Without 2 of 40 degrees of freedom, of which each joint has a sixth.
    np.testing.assert_allclose(noise.deviations[:6], clean.deviations[:6], rtol=0.25)


def test_of_three_visits_the_one_that_disagrees_is_excluded() -> None:
    _, data, _ = repeated_poses(17, poses=20, visits=3)
    noise = fit_joint_noise(gather_scatters(_spoilt(data, 7), KR5_ARC))
    assert np.flatnonzero(noise.outliers).tolist() == [7]


def test_poses_of_two_visits_lose_one_in_a_hundred_sessions() -> None:
    runs = 60
    wrong = sum(
        fit_joint_noise(
            gather_scatters(repeated_poses(300 + seed, visits=2, poses=20)[1], KR5_ARC)
        ).outliers.any()
        for seed in range(runs)
    )
    assert wrong <= 4  # .01 of 60 sessions: five or more have a chance of 3e-4


def test_too_few_poses_whose_visits_agree_are_refused() -> None:
    _, data, _ = repeated_poses(18, poses=4, visits=20)
    kept = slice(18, None)  # of the first pose two visits
    assert data.rotations is not None
    data = PoseData(
        data.joint_angles[kept],
        data.positions_mm[kept],
        data.rotations[kept],
        None if data.covariance is None else data.covariance[kept],
        labels=data.labels[kept],
    )
    fit_joint_noise(gather_scatters(data, KR5_ARC))
    with pytest.raises(TooFewPoses, match="Only at 3 of 4 poses do repeated visits agree"):
        fit_joint_noise(gather_scatters(_spoilt(data, 0), KR5_ARC))


def test_few_repeated_poses_are_refused() -> None:
    _, data, _ = repeated_poses(7, poses=3)
    with pytest.raises(TooFewPoses, match="3 poses were visited more than once"):
        gather_scatters(data, KR5_ARC)


@pytest.mark.parametrize("rotations", [True, False])
def test_poses_of_one_orientation_do_not_determine_the_tool(rotations: bool) -> None:
    _, data, _ = repeated_poses(8, half_range=math.radians(1e-4), rotations=rotations)
    with pytest.raises(MotionInsufficient, match="differ too little to determine the tool"):
        gather_scatters(data, KR5_ARC)


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    inside = np.zeros(6)
    runs = 60
    for seed in range(runs):
        _, data, _ = repeated_poses(100 + seed, poses=10, visits=10)
        low, high = fit_joint_noise(gather_scatters(data, KR5_ARC)).interval(1.959964)
        inside += (low[:6] <= JOINT_SIGMA) & (high[:6] >= JOINT_SIGMA)
    share = inside.sum() / (6 * runs)
    assert abs(share - 0.95) < 3.0 * math.sqrt(0.95 * 0.05 / (6 * runs)) + 0.02
