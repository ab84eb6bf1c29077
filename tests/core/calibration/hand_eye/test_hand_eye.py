"""Frames tied by commanded poses: exact, within uncertainty, sound against wrong poses."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration.hand_eye import (
    average_station,
    calibrate_hand_eye,
)
from core.calibration.hand_eye.model import Frames, PoseArrays, jacobian, measurement_effect, residuals
from core.errors import InvalidArgument
from core.geometry.se3 import perturbed, transform
from tests.support.simulation.hand_eye_poses import (
    MEASURED_COVARIANCE,
    T_BASE_TARGET,
    T_FLANGE_CAMERA,
    draw_stations,
    errors,
    exact,
)


@pytest.mark.parametrize("count", [3, 4, 12])
def test_exact_poses_give_the_frames(count: int) -> None:
    tie = calibrate_hand_eye(exact(1, count))
    np.testing.assert_allclose(errors(tie), 0.0, atol=1e-7)
    assert [d.pose_id for d in tie.deviations] == [f"P{i + 1}" for i in range(count)]
    assert all(np.linalg.norm(d.position_mm) < 1e-6 for d in tie.deviations)
    assert tie.warnings == ()


def test_names_cancel() -> None:
    tie = calibrate_hand_eye(exact(2, 8))
    for station in exact(2, 8):
        found = tie.frames.attained(station.T_target_camera[None])[0]
        np.testing.assert_allclose(found, station.T_base_flange, atol=1e-6)


def test_derivatives_match_differences() -> None:
    rng = np.random.default_rng(3)
    given = draw_stations(rng, 5)
    poses = PoseArrays(
        np.array([s.T_base_flange for s in given]),
        np.array([s.T_target_camera for s in given]),
        np.zeros((5, 6, 6)),
        np.zeros(5, dtype=np.intp),
    )
    frames, h = Frames(T_FLANGE_CAMERA, T_BASE_TARGET[None]), 1e-6
    J = jacobian(frames, poses.T_target_camera)
    for k in range(12):
        step = np.zeros(12)
        step[k] = h
        difference = (residuals(frames.moved(-step), poses) - residuals(frames.moved(step), poses)) / (2 * h)
        # Residuals of some 1e-3 rad turn the derivative of the logarithm by half as much.
        np.testing.assert_allclose(J[:, :, k], difference, atol=2e-3)
    G = measurement_effect(frames, poses.T_target_camera)
    for k in range(6):
        step = np.zeros(6)
        step[k] = h
        both = [
            residuals(
                frames,
                dataclasses.replace(
                    poses, T_target_camera=np.array([perturbed(T, s) for T in poses.T_target_camera])
                ),
            )
            for s in (-step, step)
        ]
        np.testing.assert_allclose(G[:, :, k], (both[0] - both[1]) / (2 * h), atol=2e-3)


def covered(trials: int, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return for each trial and component whether the 95 % interval holds the truth; the robot's deviations found."""
    rng = np.random.default_rng(seed)
    inside, robot = [], []
    for _ in range(trials):
        tie = calibrate_hand_eye(draw_stations(rng, count))
        inside.append(np.abs(errors(tie)) < tie.coverage_factor * np.sqrt(np.diag(tie.covariance)))
        robot.append((tie.robot_position_mm, tie.robot_rotation))
    return np.array(inside), np.array(robot)


def test_stated_uncertainty_and_deviations_are_right() -> None:
    inside, robot = covered(60, 10, 4)
    # 720 intervals in groups of 12 that share a fit: a standard error of some 1.2 %.
    assert inside.mean() > 0.915
    square = np.mean(robot**2, axis=0)
    # 60 x 24 degrees of freedom each: 3.7 % in the square root's square, three of those and the split's own.
    np.testing.assert_allclose(np.sqrt(square), [0.3, math.radians(0.03)], rtol=0.08)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "seed"), [(5, 6), (12, 7)])
def test_intervals_cover_95_percent(count: int, seed: int) -> None:
    inside, robot = covered(250, count, seed)
    # 250 fits of 12 components: a standard error of .6 % at most, and of 1.4 % for one component.
    assert 0.93 < inside.mean() < 0.97
    assert np.all(inside.mean(axis=0) > 0.90)
    np.testing.assert_allclose(np.sqrt(np.mean(robot**2, axis=0)), [0.3, math.radians(0.03)], rtol=0.08)


def test_held_out_is_what_the_other_poses_say() -> None:
    given = draw_stations(np.random.default_rng(9), 10)
    tie = calibrate_hand_eye(given)
    for i in (0, 4, 9):
        d = tie.deviations[i]
        others = calibrate_hand_eye(given[:i] + given[i + 1 :])
        attained = others.frames.attained(given[i].T_target_camera[None])[0]
        expected = attained[:3, 3] - given[i].T_base_flange[:3, 3]
        assert d.held_out_position_mm is not None
        # The weights of position and rotation differ a little without the pose.
        np.testing.assert_allclose(d.held_out_position_mm, expected, atol=0.03)
        assert np.linalg.norm(expected) > 0.9 * np.linalg.norm(d.position_mm)


@pytest.mark.parametrize("kind", ["another's command", "origin at the other end", "typing error"])
@pytest.mark.parametrize("count", [8, 15])
def test_one_wrong_pose_is_excluded_and_named(kind: str, count: int) -> None:
    rng = np.random.default_rng(10)
    for trial in range(5):
        given = draw_stations(rng, count)
        wrong = trial + 1
        s = given[wrong]
        if kind == "another's command":
            s = dataclasses.replace(s, T_base_flange=given[wrong - 1].T_base_flange)
        elif kind == "origin at the other end":
            turned = transform(np.diag([-1.0, -1.0, 1.0]), np.array([130.0, 90.0, 0.0]))
            s = dataclasses.replace(s, T_target_camera=turned @ s.T_target_camera)
        else:
            s = dataclasses.replace(
                s, T_base_flange=perturbed(s.T_base_flange, np.array([10.0, 0, 0, 0, 0, 0]))
            )
        tie = calibrate_hand_eye([*given[:wrong], s, *given[wrong + 1 :]])
        assert [d.pose_id for d in tie.deviations if not d.used] == [s.pose_id]
        assert [w.code for w in tie.warnings] == ["poses_excluded"]
        assert s.pose_id in tie.warnings[0].detail
        assert np.all(np.abs(errors(tie)) < 6.0 * np.sqrt(np.diag(tie.covariance)))


@pytest.mark.parametrize(("sessions", "most"), [(40, 2), pytest.param(150, 4, marks=pytest.mark.slow)])
def test_six_sound_poses_all_tie_the_frames(sessions: int, most: int) -> None:
    """Three of six poses fit nearly exactly whatever they are: their small residuals are no evidence against the rest.

    By distance in robust deviations alone, one session in ten lost half of its poses.
    """
    rng = np.random.default_rng(21)
    lost = 0
    for _ in range(sessions):
        given = draw_stations(rng, 6, robot_rad=0.0, noise=0.1)
        lost += not all(d.used for d in calibrate_hand_eye(given).deviations)
    # One session in a hundred at most by construction: more have a probability of 1 and of 2 %.
    assert lost <= most


def test_nothing_is_excluded_from_a_sound_session() -> None:
    rng = np.random.default_rng(11)
    for count in (6, 8, 20):
        for _ in range(15):
            assert all(d.used for d in calibrate_hand_eye(draw_stations(rng, count)).deviations)


def test_the_mean_of_many_cycles_is_where_the_pose_is() -> None:
    rng = np.random.default_rng(18)
    given = draw_stations(rng, 12)[3]
    root = np.linalg.cholesky(MEASURED_COVARIANCE)
    cycles = np.array([perturbed(given.T_target_camera, root @ rng.normal(0.0, 1.0, 6)) for _ in range(400)])
    station = average_station("P4", given.T_base_flange, cycles, np.array([MEASURED_COVARIANCE] * 400))
    np.testing.assert_allclose(station.T_target_camera, given.T_target_camera, atol=0.02)


def test_what_all_poses_share_shifts_the_frames_and_not_the_deviations() -> None:
    """An error of depth is an error of where the camera sits along its axis, and of nothing else."""
    given = [
        dataclasses.replace(s, common=np.concatenate([2.0 * s.T_target_camera[:3, 2], np.zeros(3)])[:, None])
        for s in draw_stations(np.random.default_rng(20), 10)
    ]
    tie, alone = (
        calibrate_hand_eye(given),
        calibrate_hand_eye([dataclasses.replace(s, common=None) for s in given]),
    )
    np.testing.assert_allclose(tie.covariance_given_camera, alone.covariance)
    along = tie.T_flange_camera[:3, 2]
    extra = tie.covariance - tie.covariance_given_camera
    np.testing.assert_allclose(extra[:3, :3], 4.0 * np.outer(along, along), atol=0.02)
    np.testing.assert_allclose(extra[3:, 3:], 0.0, atol=0.02)
    for d in tie.deviations:
        np.testing.assert_allclose(d.common, 0.0, atol=0.03)
    with pytest.raises(InvalidArgument, match="share"):
        calibrate_hand_eye([dataclasses.replace(given[0], common=None), *given[1:]])


def test_errors_in_common_are_covered() -> None:
    """Each pose is off by what two common errors do to it: intervals that know of them cover, others fall short."""
    rng = np.random.default_rng(21)
    inside, ignorant = [], []
    for _ in range(40):
        given, z = [], rng.normal(0.0, 1.0, 2)
        for s in draw_stations(rng, 12):
            R, p = s.T_target_camera[:3, :3], s.T_target_camera[:3, 3]
            common = np.zeros((6, 2))
            common[:3, 0] = 3.0 * R[:, 2] * np.linalg.norm(p) / 400.0
            common[3:, 1] = 0.005 * R[:, 0]
            shifted = perturbed(s.T_target_camera, -common @ z)
            given.append(dataclasses.replace(s, T_target_camera=shifted, common=common))
        tie = calibrate_hand_eye(given)
        for results, C in ((inside, tie.covariance), (ignorant, tie.covariance_given_camera)):
            results.append(np.abs(errors(tie)) < tie.coverage_factor * np.sqrt(np.diag(C)))
    # 480 intervals, 12 to a fit: a standard error of 1.5 %.
    assert np.mean(inside) > 0.90
    assert np.mean(ignorant) < 0.85
