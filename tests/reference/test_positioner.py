"""A two-axis positioner seen by a camera: 205 poses of a target on it, at joint angles, by people with another purpose.

Data: Jmeyer1292/robot_cal_tools, Apache-2.0: poses (m, quaternion) and joint angles (rad). Joint 1 tilts over 60° at 16
settings of joint 2, which goes round 338° at 13 settings of joint 1; the axes are nominally perpendicular and meet.
No reference is published, so halves are compared with each other, by the uncertainties they state.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from core.kinematics.circle_point_analysis.identification import AxesIdentification, identify_from_axes
from core.kinematics.identification import identify
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import find_sweeps
from core.session.robot.method_agreement import compare_methods

TOLERANCE = math.radians(0.2)  # the drives stop within that


@pytest.fixture(scope="module")
def poses(data_folder: Path) -> PoseData:
    file = data_folder / "robot_cal_tools" / "positioner_kinematic_measurements.yaml"
    rows = list(yaml.safe_load(file.read_text()).values())
    quaternions = [[row["pose"][f"q{c}"] for c in "xyzw"] for row in rows]
    return PoseData(
        np.array([row["target_joints"] for row in rows]),
        1000.0 * np.array([[row["pose"][c] for c in "xyz"] for row in rows]),
        Rotation.from_quat(quaternions).as_matrix(),
    )


def axes(poses: PoseData) -> tuple[np.ndarray, np.ndarray, AxesIdentification]:
    """Distance (mm) and angle (rad) of the two axes, their standard uncertainties."""
    found = identify_from_axes(poses, tolerance=TOLERANCE)
    joint = found.joints[0]
    uncertainty = [joint.standard_uncertainty[name] for name in ("a_mm", "alpha_rad")]
    return (
        np.array([joint.parameters.a_mm, abs(joint.parameters.alpha_rad)]),
        np.array(uncertainty, dtype=np.float64),
        found,
    )


def test_two_axes_nearly_meet_at_a_right_angle(poses: PoseData) -> None:
    assert len(poses) == 205
    value, uncertainty, found = axes(poses)
    assert 0.3 < value[0] < 1.0
    assert value[1] == pytest.approx(math.pi / 2.0, abs=math.radians(0.05))
    assert uncertainty[0] < 0.15
    assert math.degrees(uncertainty[1]) < 0.01
    # A camera of that time before a printed target: some tenths of a millimetre, some hundredths of a degree.
    assert found.residual_mm < 0.6
    assert found.residual_rad is not None
    assert math.degrees(found.residual_rad) < 0.08
    assert len(found.fits.arcs) > 20


def test_halves_agree_within_what_they_state(poses: PoseData) -> None:
    first, second = (axes(poses.take(np.flatnonzero(half))) for half in _halves(poses))
    apart = (first[0] - second[0]) / np.hypot(first[1], second[1])
    # The target's systematic errors depend on the view, which the halves share only in part.
    assert np.all(np.abs(apart) < 4.0)
    assert abs(first[0][0] - second[0][0]) < 0.3
    assert math.degrees(abs(first[0][1] - second[0][1])) < 0.03


def _halves(poses: PoseData) -> tuple[np.ndarray, np.ndarray]:
    """Deal the settings of joint 2 into two halves: each keeps arcs of joint 1, and every other point of joint 2's."""
    place = np.round(poses.joint_angles[:, 1] / math.radians(22.5)).astype(int) % 2
    return place == 0, place == 1


@pytest.mark.slow
def test_methods_find_the_same_two_axes(poses: PoseData) -> None:
    """The axes pass one another by .7 mm: a hair decides which sense of x a method takes, and counts for nothing."""
    found, sweeps = identify(poses, folds=0), find_sweeps(poses, tolerance=TOLERANCE)
    agreement = compare_methods(found.joints, poses, None, sweeps, TOLERANCE)
    assert {one.method for one in agreement} == {"cpa", "screw", "combined"}
    assert all(one.largest is not None and one.largest < 5.0 for one in agreement)
