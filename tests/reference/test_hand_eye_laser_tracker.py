"""Frames tied with a laser tracker's T-Mac in the camera's place: a UR10's 25 hand-eye poses.

Data: christianlandgraf/ipa-robot-accuracy, MIT; flange poses by the robot's own kinematics (m, quaternion), T-Mac poses
by a Leica tracker (mm, Euler angles in degrees, R = Rx Ry Rz), good to some hundredths of a millimetre. The robot's
nominal kinematics are off by half a millimetre, which is what a UR10 is known for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from core.calibration.hand_eye import (
    HandEyeObservation,
    PositionObservation,
    calibrate_from_positions,
    calibrate_hand_eye,
)
from core.errors import NotConverged
from core.geometry.se3 import invert, so3_exp, transform


def turn(axis: int, degrees: float) -> np.ndarray:
    return so3_exp(math.radians(degrees) * np.eye(3)[axis])


def stations(data_folder: Path, order: Sequence[int]) -> list[HandEyeObservation]:
    """T_base_flange and T_tracker_tmac; Euler rotations multiplied in the order of the axes given."""
    file = data_folder / "ur10_lasertracker" / "Series_B" / "calibration_handeye.csv"
    found = []
    for index, line in enumerate(file.read_text().splitlines()[1:]):
        values = np.array([float(text.replace(",", ".")) for text in line.split(";")])
        axis, w = values[3:6], values[6]
        angle = 2.0 * math.atan2(float(np.linalg.norm(axis)), w)
        flange = transform(so3_exp(axis / np.linalg.norm(axis) * angle), 1000.0 * values[:3])
        turns = [turn(k, values[10 + k]) for k in order]
        found.append(
            HandEyeObservation(f"{index}", flange, transform(turns[0] @ turns[1] @ turns[2], values[7:10]))
        )
    return found


def test_the_robot_is_off_by_half_a_millimetre(data_folder: Path) -> None:
    given = stations(data_folder, (0, 1, 2))
    assert len(given) == 25
    tie = calibrate_hand_eye(given)
    assert all(d.used for d in tie.deviations)
    assert tie.warnings == ()
    assert 0.2 < tie.robot_position_mm < 1.0
    assert tie.robot_rotation < math.radians(0.06)
    # The T-Mac sits on the flange's axis; how far out is read from the data themselves.
    x, y, z = tie.T_flange_camera[:3, 3]
    u = np.sqrt(np.diag(tie.covariance))
    assert x == pytest.approx(93.2, abs=3.0 * u[0])
    assert abs(y) < 3.0 * u[1]
    assert abs(z) < 3.0 * u[2]
    # Tied by one half, the other half is as far off as the tie says the robot is.
    half = calibrate_hand_eye(given[::2])
    off = [
        half.frames.attained(s.T_target_camera[None])[0, :3, 3] - s.T_base_flange[:3, 3] for s in given[1::2]
    ]
    assert np.sqrt(np.mean(np.square(off))) < 2.0 * tie.robot_position_mm


def test_positions_alone_find_the_same_point(data_folder: Path) -> None:
    given = stations(data_folder, (0, 1, 2))
    tie = calibrate_hand_eye(given)
    alone = calibrate_from_positions(
        [PositionObservation(s.pose_id, s.T_base_flange[:3, 3], s.T_target_camera) for s in given]
    )
    u = np.sqrt(np.diag(alone.covariance))[:3]
    assert np.all(np.abs(alone.point_camera_mm - invert(tie.T_flange_camera)[:3, 3]) < 4.0 * u)


def test_the_wrong_order_of_angles_is_refused_with_that_advice(data_folder: Path) -> None:
    with pytest.raises(NotConverged) as failure:
        calibrate_hand_eye(stations(data_folder, (2, 1, 0)))
    assert "Rz Ry Rx" in str(failure.value.advice)
