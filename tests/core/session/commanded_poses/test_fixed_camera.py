"""A fixed camera that looks at a target on the robot's flange, from grid points of known truth."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration import HandEyeObservation
from core.errors import NotConverged, SeveralTargetsOnFlange
from core.geometry import compose, invert, so3_exp, so3_log, transform
from core.kinematics import forward
from core.session import (
    CommandedPose,
    ImageObservation,
    SessionData,
    assess_repeatability,
    calibrate_session_hand_eye,
    estimate_session,
    group_views,
    suggest_hand_eye_views,
)
from core.session.camera_mount import moving_poses
from core.session.commanded_poses.likely_causes import calibrate_or_explain
from core.session.next_view import candidate_views, common_fit
from core.session.next_view.reach import stated_candidates
from core.session.next_view.views_expected import camera_of, image_size
from core.simulation.arm import KR5_ARC
from tests.support.sessions.stored_sessions import BOARD, HEIGHT, WIDTH, commanded_pose, draw_board_pose, look

T_BASE_CAMERA = transform(so3_exp(np.array([0.3, math.pi - 0.4, 0.2])), np.array([900.0, -150.0, 1200.0]))
T_FLANGE_TARGET = transform(so3_exp(np.array([0.1, -0.2, 1.2])), np.array([-60.0, 40.0, 30.0]))
ROBOT_MM, ROBOT_RAD = 0.2, 2e-4
CYCLES = 3


def session(seed: int, poses: int = 12, *, scatter_mm: float = 0.0, scatter: float = 0.0) -> SessionData:
    """Draw cycles of poses before the fixed camera; `scatter` is the flange's from cycle to cycle, mm and rad."""
    rng = np.random.default_rng(seed)
    images, points, commanded = [], {}, {}
    for k in range(poses):
        name = f"P{k + 1}"
        flange = compose(T_BASE_CAMERA, draw_board_pose(rng, 30.0), invert(T_FLANGE_TARGET))
        off = so3_exp(rng.normal(0.0, ROBOT_RAD, 3))
        stated = transform(off @ flange[:3, :3], flange[:3, 3] + rng.normal(0.0, ROBOT_MM, 3))
        commanded[name] = CommandedPose(**commanded_pose(stated))
        for cycle in range(1, CYCLES + 1):
            turn = so3_exp(rng.normal(0.0, scatter, 3))
            attained = transform(turn @ flange[:3, :3], flange[:3, 3] + rng.normal(0.0, scatter_mm, 3))
            points[len(images)] = look(rng, compose(invert(T_BASE_CAMERA), attained, T_FLANGE_TARGET))
            images.append(
                ImageObservation(
                    f"m{len(images)}", name, cycle, f"{k}-{cycle}", 0, "default", None, WIDTH, HEIGHT
                )
            )
    return SessionData(
        (BOARD,), ("a",), tuple(images), group_views(images, points), commanded, camera_mount="fixed"
    )


def errors(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.append(truth[:3, 3] - found[:3, 3], so3_log(truth[:3, :3] @ found[:3, :3].T))


def test_the_camera_is_in_the_base_and_the_target_on_the_flange() -> None:
    data = session(1)
    found = calibrate_session_hand_eye(data, estimate_session(data))
    tie = found.calibration
    assert (found.camera_mount, found.targets) == ("fixed", (0,))
    off = np.concatenate(
        [errors(tie.T_flange_camera, T_FLANGE_TARGET), errors(tie.T_base_targets[0], T_BASE_CAMERA)]
    )
    inside = np.abs(off) <= tie.coverage_factor * np.sqrt(np.diag(found.covariance))
    assert inside.mean() > 0.7
    assert np.abs(off[:3]).max() < 2.0
    assert np.abs(off[6:9]).max() < 5.0
    # Deviations are the robot's, in its base: not multiplied by the distance of base and camera.
    assert tie.robot_position_mm < 3.0 * ROBOT_MM
    assert tie.robot_rotation < 3.0 * ROBOT_RAD


def test_next_views_command_the_flange_that_brings_the_target_there() -> None:
    data = session(2)
    estimate = estimate_session(data)
    found = suggest_hand_eye_views(data, estimate, estimate.groups[0], 0, 2)
    for view, flange in zip(found.T_camera_target, found.T_base_flange, strict=True):
        truth = compose(T_BASE_CAMERA, view, invert(T_FLANGE_TARGET))
        off = errors(flange, truth)
        assert np.abs(off[:3]).max() < 5.0
        assert np.abs(off[3:]).max() < 0.01
    assert found.position_mm[-1] < found.position_mm[0]


def test_of_stated_candidates_the_view_is_what_a_fixed_camera_sees_of_the_target_on_the_flange() -> None:
    data = session(2)
    group = estimate_session(data).groups[0]
    view = candidate_views(data.targets[0], camera_of(common_fit(group)), image_size(common_fit(group)), 1)[0]
    there = np.radians([[0.0, -65.0, 75.0, 10.0, 55.0, 0.0], [90.0, -65.0, 75.0, 10.0, 55.0, 0.0]])
    T_base_camera = compose(forward(KR5_ARC, there[:1])[0], T_FLANGE_TARGET, invert(view))
    found = stated_candidates(
        group, data.targets[0], T_FLANGE_TARGET, T_base_camera, KR5_ARC, there, data.camera_mount
    )
    assert found.stated is not None
    assert found.stated.tolist() == [0]
    np.testing.assert_allclose(found.T_camera_target[0], view, atol=1e-9)


def test_repeatability_is_the_targets_as_the_fixed_camera_sees_it() -> None:
    # 1 mrad of the camera's distance would be some 0.5 mm: it must not be in the figures of the target.
    data = session(3, scatter_mm=0.02, scatter=1e-3)
    estimate = estimate_session(data)
    moving = moving_poses(data, estimate.poses)
    lever = np.linalg.norm(T_FLANGE_TARGET[:3, 3])
    found = assess_repeatability(data, estimate)
    rp = [row.figures.repeatability.position_mm for row in found.poses if row.figures is not None]
    assert all(value is not None and value < 6.0 * (0.02 + 1e-3 * lever + 0.05) for value in rp)
    assert len(found.accuracy.poses) == 12
    truth = invert(T_BASE_CAMERA)
    for pose in moving[:3]:
        commanded = data.commanded[pose.pose_id]
        rotation = commanded.rotation()
        assert rotation is not None
        expected = compose(truth, transform(rotation, np.array(commanded.position_mm)), T_FLANGE_TARGET)
        np.testing.assert_allclose(pose.position_mm, expected[:3, 3], atol=6.0)


def test_the_covariance_of_an_inverse_is_that_of_moved_poses() -> None:
    rng = np.random.default_rng(4)
    data = session(4, 4)
    pose = estimate_session(data).poses[0]
    assert pose.rotation is not None
    assert pose.scatter is not None
    C = np.diag([0.1, 0.2, 0.3, 1e-3, 2e-3, 1e-3]) ** 2
    (inverse,) = moving_poses(data, [dataclasses.replace(pose, scatter=C)])
    assert inverse.rotation is not None
    assert inverse.scatter is not None
    drawn = rng.multivariate_normal(np.zeros(6), C, 4000)
    off = []
    for step in drawn:
        T = invert(transform(so3_exp(step[3:]) @ pose.rotation, pose.position_mm + step[:3]))
        off.append(np.append(T[:3, 3] - inverse.position_mm, so3_log(T[:3, :3] @ inverse.rotation.T)))
    unit = 1.0 / np.sqrt(np.diag(inverse.scatter))
    sampled = np.cov(np.array(off).T) * np.outer(unit, unit)
    np.testing.assert_allclose(sampled, inverse.scatter * np.outer(unit, unit), atol=0.12)


def nine_stations(*, fixed: bool) -> list[HandEyeObservation]:
    """Five places of one orientation and four tilts, of a camera on the robot; `fixed`: taken for one that stands
    still, which makes no more than four poses outliers.
    """
    rng = np.random.default_rng(4)
    base = transform(so3_exp(np.array([0.3, 2.0, 0.4])), np.array([800.0, -100.0, 300.0]))
    flange = transform(so3_exp(np.array([0.05, -0.1, 0.3])), np.array([40.0, 20.0, 90.0]))
    places = 45.0 * np.array(
        [[0, 0, 0], [1, 0.8, 1], [-1, 0.8, 1], [-1, -0.8, -1], [1, -0.8, -1]] + 4 * [[0, 0, 0]]
    )
    tilts = np.radians(5 * [[15, 5, 0]] + [[25, 0, 0], [-25, 0, 30], [0, 25, 60], [0, -25, 90]])
    found = []
    for k, (place, tilt) in enumerate(zip(places, tilts, strict=True)):
        R = so3_exp(tilt * [1.0, 1.0, 0.0]) @ so3_exp(tilt * [0.0, 0.0, 1.0])
        T = transform(R, np.array([75.0, 52.5, 0.0]) + place * [1.0, 1.0, 0.0] - (300.0 - place[2]) * R[:, 2])
        seen = transform(R @ so3_exp(rng.normal(0.0, 2e-4, 3)), T[:3, 3] + rng.normal(0.0, 0.1, 3))
        found.append(
            HandEyeObservation(
                f"P{k + 1}",
                np.linalg.inv(base) @ T @ np.linalg.inv(flange),
                np.linalg.inv(seen) if fixed else seen,
            )
        )
    return found


def test_the_wrong_mount_is_named_where_it_has_many_poses_rejected() -> None:
    tie = calibrate_or_explain(nine_stations(fixed=True), "fixed")
    assert {"poses_excluded", "camera_mount_unlikely"} <= {one.code for one in tie.warnings}


def test_poses_rejected_for_reasons_of_their_own_leave_the_mount_as_it_is() -> None:
    stations = nine_stations(fixed=False)
    third, fourth = stations[2:4]
    stations[2] = dataclasses.replace(third, T_target_camera=fourth.T_target_camera)
    stations[3] = dataclasses.replace(fourth, T_target_camera=third.T_target_camera)
    tie = calibrate_or_explain(stations, "robot")
    assert [one.code for one in tie.warnings] == ["poses_excluded"]


def test_the_wrong_mount_is_named_where_the_other_ties_far_better() -> None:
    data = session(5)
    taken = dataclasses.replace(data, camera_mount="robot")
    estimate = estimate_session(taken)
    with pytest.raises(NotConverged) as refused:
        calibrate_session_hand_eye(taken, estimate)
    assert refused.value.advice is not None
    assert "camera_mount to fixed" in refused.value.advice
    warned = " ".join(w.advice or "" for w in assess_repeatability(taken, estimate).accuracy.warnings)
    assert "camera_mount to fixed" in warned


def test_several_targets_on_the_flange_are_refused() -> None:
    data = session(6, 6)
    images = tuple(
        dataclasses.replace(image, target=1) if image.pose_id == "P6" else image for image in data.images
    )
    data = dataclasses.replace(data, targets=(BOARD, BOARD), target_ids=("a", "b"), images=images)
    with pytest.raises(SeveralTargetsOnFlange):
        calibrate_session_hand_eye(data, estimate_session(data))
