"""The camera on the flange and the targets in the base, from grid points of known truth."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest

from core.calibration import calibrate_hand_eye, scale_warnings
from core.errors import CommandedPosesMissing, MotionInsufficient, NotConverged
from core.geometry import compose, invert, so3_exp, so3_log, transform
from core.session import (
    CommandedPose,
    ImageObservation,
    SessionData,
    SessionHandEye,
    calibrate_session_hand_eye,
    estimate_session,
    group_views,
    image_poses,
)
from tests.support.sessions.repeatability import T_BASE_TARGET, T_FLANGE_CAMERA
from tests.support.sessions.stored_sessions import BOARD, HEIGHT, WIDTH, commanded_pose, draw_board_pose, look
from tests.support.simulation.hand_eye_poses import draw_stations

SECOND = transform(so3_exp(np.array([0.2, math.pi - 0.3, 0.1])), np.array([650.0, -260.0, 240.0]))
"""The second target in the base."""


def session(
    seed: int,
    poses: int,
    *,
    robot_mm: float = 0.2,
    targets: int = 1,
    turned: bool = True,
    both: bool = False,
    bow_mm: float = 0.0,
) -> SessionData:
    """Draw two cycles; every third pose is before the second target, with `both` each is before either."""
    rng = np.random.default_rng(seed)
    images, points, commanded = [], {}, {}
    start = draw_board_pose(rng, 30.0)
    for k in range(poses):
        name = f"P{k + 1}"
        T_camera_target = draw_board_pose(rng, 30.0)
        if not turned:
            T_camera_target = transform(start[:3, :3], T_camera_target[:3, 3])
        shown = [0, 1] if both else [1 if targets == 2 and k % 3 == 2 else 0]
        of_first = (T_BASE_TARGET, SECOND)[shown[0]]
        attained = compose(of_first, invert(T_camera_target), invert(T_FLANGE_CAMERA))
        turn = so3_exp(rng.normal(0.0, 2e-4, 3))
        stated = transform(turn @ attained[:3, :3], attained[:3, 3] + rng.normal(0.0, robot_mm, 3))
        commanded[name] = CommandedPose(**commanded_pose(stated))
        for cycle in (1, 2):
            for target in shown:
                points[len(images)] = look(rng, T_camera_target, bow_mm=bow_mm)
                images.append(
                    ImageObservation(
                        f"m{len(images)}", name, cycle, f"{k}{cycle}", target, "default", None, WIDTH, HEIGHT
                    )
                )
    specs = (BOARD,) * targets
    return SessionData(specs, ("a", "b")[:targets], tuple(images), group_views(images, points), commanded)


def errors(found: SessionHandEye) -> np.ndarray:
    """Return true - estimated, in the order of the covariance."""
    tie = found.calibration
    pairs = zip(
        (T_FLANGE_CAMERA, T_BASE_TARGET, SECOND), (tie.T_flange_camera, *tie.T_base_targets), strict=False
    )
    return np.concatenate(
        [np.append(t[:3, 3] - T[:3, 3], so3_log(t[:3, :3] @ T[:3, :3].T)) for t, T in pairs]
    )


def inside(found: SessionHandEye) -> np.ndarray:
    """Return for each component whether the 95 % interval holds the truth."""
    u = found.calibration.coverage_factor * np.sqrt(np.diag(found.covariance))
    return np.asarray(np.abs(errors(found)) <= u)


def test_camera_and_targets_are_where_they_are() -> None:
    data = session(1, 9, targets=2)
    estimate = estimate_session(data)
    found = calibrate_session_hand_eye(data, estimate)
    assert found.targets == (0, 1)
    assert found.covariance.shape == (18, 18)
    assert inside(found).mean() > 0.7
    assert np.abs(errors(found)[:3]).max() < 2.0
    assert [(s.pose_id, s.target, s.visits) for s in found.stations[:3]] == [
        ("P1", 0, 2),
        ("P2", 0, 2),
        ("P3", 1, 2),
    ]
    assert found.validation is not None
    assert found.residual.position_rms_mm < found.validation.position_rms_mm < 3.0
    assert found.excluded == ()
    shown = image_poses(data, estimate)
    assert len(shown) == 18
    assert all(one.used and one.reason is None and one.pose is not None for one in shown)


def test_stations_of_one_pose_are_not_counted_as_independent() -> None:
    data = session(2, 8, targets=2, both=True)
    # Both targets are drawn at one place: what matters is that each pose has two stations.
    found = calibrate_session_hand_eye(data, estimate_session(data))
    tie = found.calibration
    added = found.covariance - tie.covariance
    np.testing.assert_allclose(added, tie.covariance_given_camera, rtol=1e-12)


@pytest.mark.parametrize("targets", [1, 2])
def test_ids_of_one_command_are_one_station(targets: int) -> None:
    """The second cycle under an id of its own changes the frames by rounding, and which deviations are listed."""
    data = session(6, 7, targets=targets, both=targets == 2)
    one = calibrate_session_hand_eye(data, estimate_session(data))
    images = [dataclasses.replace(i, pose_id=i.pose_id + "ab"[(i.cycle or 1) - 1]) for i in data.images]
    commanded = {p + letter: c for p, c in data.commanded.items() for letter in "ab"}
    divided = dataclasses.replace(data, images=tuple(images), commanded=commanded)
    two = calibrate_session_hand_eye(divided, estimate_session(divided))
    assert two.calibration.degrees_of_freedom == one.calibration.degrees_of_freedom
    np.testing.assert_allclose(two.calibration.T_flange_camera, one.calibration.T_flange_camera, atol=1e-3)
    # Twice as many stations of one variance would have uncertainties smaller by √2.
    np.testing.assert_allclose(*(np.sqrt(np.diag(found.covariance)) for found in (two, one)), rtol=0.05)
    assert [(s.pose_id, s.target, s.visits) for s in two.stations] == sorted(
        (s.pose_id + letter, s.target, 1) for s in one.stations for letter in "ab"
    )
    twins = {
        key: [s for s in two.stations if (s.pose_id[:-1], s.target) == key] for key in (("P3", 0), ("P5", 0))
    }
    for station in one.stations:
        for twin in twins.get((station.pose_id, station.target), []):
            # Both ids are held out: what the twin tied would be far less off.
            apart = twin.deviation.position_mm - station.deviation.position_mm
            assert np.linalg.norm(apart) < 0.2
            np.testing.assert_allclose(
                twin.deviation.held_out_position_mm, station.deviation.held_out_position_mm + apart, atol=1e-3
            )


def test_a_session_that_does_not_determine_the_frames_says_why() -> None:
    data = session(3, 6)
    estimate = estimate_session(data)
    with pytest.raises(CommandedPosesMissing):
        calibrate_session_hand_eye(dataclasses.replace(data, commanded={}), estimate)
    same = session(4, 6, turned=False)
    few = dataclasses.replace(data, commanded={p: c for p, c in data.commanded.items() if p in ("P1", "P2")})
    for undetermined in (same, few):
        with pytest.raises(MotionInsufficient):
            calibrate_session_hand_eye(undetermined, estimate_session(undetermined))
    part = {p: c for p, c in data.commanded.items() if p != "P6"}
    found = calibrate_session_hand_eye(
        dataclasses.replace(data, commanded={**part, "P77": data.commanded["P1"]}), estimate
    )
    assert [(e.pose_id, e.code) for e in found.excluded] == [
        ("P6", "commanded_pose_missing"),
        ("P77", "no_usable_images"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("poses", "targets", "seed", "sessions"), [(8, 1, 100, 40), (15, 2, 300, 20)])
def test_intervals_cover_95_percent(poses: int, targets: int, seed: int, sessions: int) -> None:
    held = []
    for trial in range(sessions):
        data = session(seed + trial, poses, targets=targets)
        held.append(inside(calibrate_session_hand_eye(data, estimate_session(data))))
    # 40 sessions of 12 components that share a fit: a standard error of some 1.5 %; 20 of 18 components: 2 %.
    error = 0.015 if sessions == 40 else 0.02
    assert 0.95 - 3.3 * error < np.mean(held) < min(0.95 + 3.0 * error, 0.985)


@cache
def before_a_bowed_print(bow_mm: float, trial: int) -> SessionHandEye:
    data = session(500 + trial, 12, robot_mm=0.05, bow_mm=bow_mm)
    return calibrate_session_hand_eye(data, estimate_session(data))


@pytest.mark.parametrize(("bow_mm", "sessions"), [(0.1, 6), pytest.param(0.1, 30, marks=pytest.mark.slow)])
def test_before_a_bowed_print_the_camera_on_the_flange_is_covered(bow_mm: float, sessions: int) -> None:
    squared, held = [], []
    for trial in range(sessions):
        found = before_a_bowed_print(bow_mm, trial)
        u = np.sqrt(np.diag(found.covariance)[:3])
        squared.append((errors(found)[:3] / u) ** 2)
        held.append(inside(found)[:6])
    # Six components of a session that share a fit count as some three. Without the bow as an unknown rms is over 3.
    error = math.sqrt(0.95 * 0.05 / (3.0 * sessions))
    assert np.mean(held) > 0.95 - 3.0 * error
    assert math.sqrt(np.mean(squared)) < 1.0 + 3.0 / math.sqrt(4.0 * sessions)


@pytest.mark.parametrize("scale", [0.97, 1.008, 1.03])
def test_a_print_of_another_pitch_than_stated_is_recognised(scale: float) -> None:
    data = session(7, 12, robot_mm=0.05)
    scaled = {
        name: dataclasses.replace(c, position_mm=[scale * x for x in c.position_mm])
        for name, c in data.commanded.items()
        if c.position_mm is not None
    }
    estimate = estimate_session(data)
    plain = calibrate_session_hand_eye(data, estimate)
    assert "print_scale_mismatch" not in {w.code for w in plain.warnings}
    found = calibrate_session_hand_eye(dataclasses.replace(data, commanded=scaled), estimate)
    (warning,) = [w for w in found.warnings if w.code == "print_scale_mismatch"]
    assert ("longer" if scale > 1.0 else "shorter") in warning.detail
    assert found.calibration.scale is not None
    value, u = found.calibration.scale.value, found.calibration.scale.standard_uncertainty
    assert abs(value - (scale - 1.0)) < 4.0 * u
    assert u < 1e-3


@cache
def scale_ratio(trial: int) -> float:
    """Return the error of a session's scale in its stated uncertainty."""
    data = session(900 + trial, 12)
    scale = calibrate_session_hand_eye(data, estimate_session(data)).calibration.scale
    assert scale is not None
    return scale.value / scale.standard_uncertainty


@pytest.mark.parametrize("sessions", [10, pytest.param(60, marks=pytest.mark.slow)])
def test_the_scale_of_commanded_distances_is_as_uncertain_as_stated(sessions: int) -> None:
    found = [scale_ratio(trial) for trial in range(sessions)]
    rms = math.sqrt(float(np.mean(np.square(found))))
    assert 1.0 - 3.0 / math.sqrt(2.0 * sessions) < rms < 1.0 + 3.0 / math.sqrt(2.0 * sessions)


@pytest.mark.parametrize("poses", [3, 5])
def test_few_poses_name_no_scale_by_chance(poses: int) -> None:
    """The robot's variance is known by few degrees of freedom then: a normal's limit gave 14 of 297 of three poses."""
    named = 0
    for seed in range(60):
        try:
            found = calibrate_hand_eye(draw_stations(np.random.default_rng(seed), poses))
        except (MotionInsufficient, NotConverged):
            continue
        named += len(scale_warnings(found.scale, found.degrees_of_freedom))
    assert named == 0


def test_two_focus_groups_share_the_scale_of_a_print() -> None:
    data = session(11, 12)
    board = dataclasses.replace(BOARD, pitch_standard_uncertainty_mm=0.01 * BOARD.pitch_mm)
    images = [
        dataclasses.replace(image, focus_group="ab"[int(image.pose_id[1:]) % 2]) for image in data.images
    ]
    points = {
        i: dataclasses.replace(group.views.view(k), target=board)
        for group in data.views
        for k, i in enumerate(group.images.tolist())
    }
    u = []
    for groups in (images, [dataclasses.replace(image, focus_group="a") for image in images]):
        stated = dataclasses.replace(
            data, targets=(board,), images=tuple(groups), views=group_views(groups, points)
        )
        found = calibrate_session_hand_eye(stated, estimate_session(stated))
        u.append(float(np.sqrt(np.trace(found.covariance[:3, :3]))))
    # One percent of the distance is far more than what the lenses leave.
    assert u[0] == pytest.approx(u[1], rel=0.05)
