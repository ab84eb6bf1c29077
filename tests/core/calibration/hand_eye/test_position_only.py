"""Frames tied by commanded positions alone: right within uncertainty, and silent on what turning did not show."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.special import stdtrit

from core.calibration.hand_eye import PositionOnlyCalibration, calibrate_from_positions
from core.errors import InvalidArgument, MotionInsufficient
from core.geometry.se3 import so3_exp, so3_log, transform
from tests.support.simulation.hand_eye_poses import POINT_CAMERA_MM, T_BASE_TARGET, draw_position_stations


def errors(tie: PositionOnlyCalibration) -> np.ndarray:
    T = tie.T_base_target
    turn = so3_log(T_BASE_TARGET[:3, :3] @ T[:3, :3].T)
    return np.concatenate([POINT_CAMERA_MM - tie.point_camera_mm, T_BASE_TARGET[:3, 3] - T[:3, 3], turn])


@pytest.mark.parametrize("turns", ["free", "about_z", "none"])
@pytest.mark.parametrize("count", [4, 12])
def test_deviations_are_reported_whatever_the_turning(turns: str, count: int) -> None:
    """Right to the robot's deviations; the point is determined only as far as turning shows it."""
    given = draw_position_stations(np.random.default_rng(1), count, turns=turns, robot_mm=1e-6)
    tie = calibrate_from_positions(given)
    assert np.linalg.norm(tie.deviations_mm, axis=1).max() < 0.3  # the camera's noise
    attained = tie.attained(np.array([s.T_target_camera for s in given]))
    commanded = np.array([s.position_base_mm for s in given])
    np.testing.assert_allclose(attained - commanded, tie.deviations_mm, atol=1e-9)
    uncertainty = np.sqrt(np.diag(tie.covariance))
    if turns == "free":
        assert np.all(np.abs(errors(tie)) < 4.5 * uncertainty)
    else:
        assert np.all(np.abs(errors(tie)[6:]) < 4.5 * uncertainty[6:])


@pytest.mark.slow
@pytest.mark.parametrize(("turns", "count"), [("free", 8), ("none", 5)])
def test_intervals_cover_95_percent(turns: str, count: int) -> None:
    rng = np.random.default_rng(2)
    inside, robot = [], []
    for _ in range(200):
        tie = calibrate_from_positions(draw_position_stations(rng, count, turns=turns))
        kept = slice(0, 9) if turns == "free" else slice(6, 9)
        interval = stdtrit(tie.degrees_of_freedom, 0.975) * np.sqrt(np.diag(tie.covariance))
        inside.append((np.abs(errors(tie)) < interval)[kept])
        robot.append(tie.robot_position_mm)
    # 200 fits of 3 to 9 components that share much: a standard error of .8 to 1 %.
    assert 0.92 < np.mean(inside) < 0.98
    assert np.sqrt(np.mean(np.square(robot))) == pytest.approx(0.3, rel=0.06)


def test_a_long_tool_far_turned_is_found() -> None:
    rng = np.random.default_rng(3)
    point = np.array([150.0, -220.0, 300.0])
    given = []
    for s in draw_position_stations(rng, 10, robot_mm=0.0):
        T = s.T_target_camera
        inside = T[:3, 3] + T[:3, :3] @ point
        position = T_BASE_TARGET[:3, :3] @ inside + T_BASE_TARGET[:3, 3]
        given.append(dataclasses.replace(s, position_base_mm=position, covariance=None))
    tie = calibrate_from_positions(given)
    np.testing.assert_allclose(tie.point_camera_mm, point, atol=1e-6)


def test_held_out_is_what_the_other_positions_say() -> None:
    given = draw_position_stations(np.random.default_rng(6), 10)
    tie = calibrate_from_positions(given)
    for i in (0, 5):
        others = calibrate_from_positions(given[:i] + given[i + 1 :])
        expected = others.attained(given[i].T_target_camera[None])[0] - given[i].position_base_mm
        held_out = tie.held_out_mm[i]
        assert held_out is not None
        np.testing.assert_allclose(held_out, expected, atol=0.02)
        assert np.linalg.norm(expected) > np.linalg.norm(tie.deviations_mm[i])


def test_a_wrong_position_is_excluded_and_named() -> None:
    given = draw_position_stations(np.random.default_rng(4), 10)
    moved = given[2].position_base_mm + np.array([0.0, 40.0, 0.0])
    given[2] = dataclasses.replace(given[2], position_base_mm=moved)
    tie = calibrate_from_positions(given)
    assert [i for i, used in enumerate(tie.used) if not used] == [2]
    assert "P3" in tie.warnings[0].detail
    assert abs(tie.deviations_mm[2, 1] + 40.0) < 3.0


def test_refusals() -> None:
    given = draw_position_stations(np.random.default_rng(5), 8)
    for few in ([], given[:3]):
        with pytest.raises(MotionInsufficient):
            calibrate_from_positions(few)
    spoilt = dataclasses.replace(given[0], position_base_mm=np.array([np.nan, 0.0, 0.0]))
    with pytest.raises(InvalidArgument):
        calibrate_from_positions([spoilt, *given[1:]])
    with pytest.raises(InvalidArgument, match="rotation"):
        calibrate_from_positions([dataclasses.replace(given[0], T_target_camera=2.0 * np.eye(4)), *given[1:]])
    along = []
    for i, s in enumerate(given):
        T = transform(so3_exp(np.array([0.2, 0.1, 0.3])), np.array([70.0, 50.0 + 30.0 * i, -400.0]))
        position = T_BASE_TARGET[:3, :3] @ T[:3, 3] + T_BASE_TARGET[:3, 3]
        along.append(dataclasses.replace(s, T_target_camera=T, position_base_mm=position))
    with pytest.raises(MotionInsufficient, match="on one line"):
        calibrate_from_positions(along)
    same = [dataclasses.replace(given[0], pose_id=f"P{i}") for i in range(8)]
    with pytest.raises(MotionInsufficient):
        calibrate_from_positions(same)
