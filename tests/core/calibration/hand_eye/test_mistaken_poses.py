"""Commanded poses that tie no frames, or are of another convention or unit: refused, or remarked on."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.calibration.hand_eye import (
    HandEyeObservation,
    average_station,
    calibrate_hand_eye,
)
from core.errors import InvalidArgument, MotionInsufficient, NotConverged
from core.geometry.roll_pitch_yaw import rotation_to_rpy, rpy_to_rotation
from core.geometry.se3 import perturbed, so3_exp, so3_log, transform
from tests.support.simulation.hand_eye_poses import (
    MEASURED_COVARIANCE,
    T_BASE_TARGET,
    T_FLANGE_CAMERA,
    draw_stations,
    exact,
)


@pytest.mark.parametrize(
    ("turns", "words"), [("none", "not determined in any direction"), ("about_z", "about one axis")]
)
def test_without_turning_the_camera_cannot_be_placed(turns: str, words: str) -> None:
    with pytest.raises(MotionInsufficient, match=words) as failure:
        calibrate_hand_eye(exact(12, 8, turns))
    assert failure.value.code == "motion_insufficient"
    assert failure.value.advice is not None
    if turns == "about_z":
        # z of the camera, in the flange's frame.
        named = np.array([float(v) for v in failure.value.detail.split("(")[1].split(")")[0].split(",")])
        assert abs(named @ T_FLANGE_CAMERA[:3, 2]) > 0.99


def test_barely_turned_poses_are_refused_by_their_uncertainty() -> None:
    rng = np.random.default_rng(14)
    given = []
    for i in range(8):
        R = so3_exp(np.array([0.2, 0.1, 0.3]) + rng.normal(0.0, 0.03, 3))
        T = transform(R, np.array([70.0, 50.0, -400.0]) + rng.normal(0.0, 60.0, 3))
        attained = T_BASE_TARGET @ T @ np.linalg.inv(T_FLANGE_CAMERA)
        off = np.concatenate([rng.normal(0.0, 3.0, 3), rng.normal(0.0, 1e-3, 3)])
        given.append(HandEyeObservation(f"P{i}", perturbed(attained, off), T, MEASURED_COVARIANCE))
    with pytest.raises(MotionInsufficient):
        calibrate_hand_eye(given)


def test_other_conventions_of_angles_are_noticed() -> None:
    given = draw_stations(np.random.default_rng(15), 10)
    wrong = []
    for s in given:
        roll, pitch, yaw = rotation_to_rpy(s.T_base_flange[:3, :3])
        R = (
            so3_exp(np.array([roll, 0, 0]))
            @ so3_exp(np.array([0, pitch, 0]))
            @ so3_exp(np.array([0, 0, yaw]))
        )
        wrong.append(dataclasses.replace(s, T_base_flange=transform(R, s.T_base_flange[:3, 3])))
    with pytest.raises(InvalidArgument) as failure:
        calibrate_hand_eye(wrong)
    assert "R = Rz Ry Rx" in str(failure.value.advice)


def test_metres_for_millimetres_are_noticed() -> None:
    given = [
        dataclasses.replace(
            s, T_base_flange=transform(s.T_base_flange[:3, :3], s.T_base_flange[:3, 3] / 1000.0)
        )
        for s in draw_stations(np.random.default_rng(16), 10)
    ]
    with pytest.raises((MotionInsufficient, NotConverged)) as failure:
        calibrate_hand_eye(given)
    assert failure.value.advice


def test_refusals() -> None:
    given = draw_stations(np.random.default_rng(17), 5)
    for few in ([], given[:1], given[:2]):
        with pytest.raises(MotionInsufficient):
            calibrate_hand_eye(few)
    spoilt = given[0].T_base_flange.copy()
    spoilt[0, 3] = np.nan
    stretched = given[0].T_base_flange.copy()
    stretched[:3, :3] *= 1.01
    for T in (spoilt, stretched, np.diag([1.0, 1.0, -1.0, 1.0])):
        with pytest.raises(InvalidArgument):
            calibrate_hand_eye([dataclasses.replace(given[0], T_base_flange=T), *given[1:]])
    for C in (np.full((6, 6), np.nan), -np.eye(6)):
        with pytest.raises(InvalidArgument):
            calibrate_hand_eye([dataclasses.replace(given[0], covariance=C), *given[1:]])
    with pytest.raises(InvalidArgument):
        average_station("P1", np.eye(4), np.zeros((0, 4, 4)))


def test_roll_pitch_yaw_are_read_as_documented() -> None:
    """The commanded rotation of the API is Rz(yaw) Ry(pitch) Rx(roll)."""
    for s in draw_stations(np.random.default_rng(19), 3):
        R = s.T_base_flange[:3, :3]
        assert np.linalg.norm(so3_log(rpy_to_rotation(rotation_to_rpy(R)) @ R.T)) < 1e-9
