"""The second pose of a plane under weak perspective: found, ruled out by statistics, or reported."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from core.calibration.planar_ambiguity import FALSE_CHOICE, SecondPose, mirrored, needed_evidence, second_pose
from core.calibration.priors import Lens
from core.calibration.residuals import View, descend
from core.calibration.result import Calibration
from core.calibration.single_image import calibrate_points
from core.calibration.state import centred, pose_from_undistorted_points, view_residuals
from core.errors import FocalNotObservable
from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, so3_log, transform, transform_points
from core.targets.specification import GridPoints, TargetSpec

CAMERA = Camera(2320.0, 2321.0, 1220.0, 1028.0, -0.1, 0.05, 1e-4, -1e-4)
BOARD = TargetSpec("chessboard", 14, 10, 10.0)
SMALL = TargetSpec("chessboard", 6, 5, 10.0)
SIGMA, FAR_SIGMA = 0.05, 0.15


def pose_in_view(found: Calibration) -> View:
    """The pose found before the camera that was given, of the board's middle."""
    R, middle = found.T_camera_target[:3, :3], BOARD.points_target().mean(axis=0)
    return View(CAMERA.as_array(), R, R @ middle + found.T_camera_target[:3, 3])


def cost_of(found: Calibration) -> float:
    return float(np.sum((found.residuals_px / SIGMA) ** 2))


def second_of(points: GridPoints, found: Calibration) -> SecondPose | None:
    """The second pose of a calibration with `CAMERA`, all points used."""
    used = np.ones(len(points), dtype=np.bool_)
    return second_pose(points, pose_in_view(found), used, cost_of(found), 1.0)


def tilted(
    rng: np.random.Generator, tilt_deg: float, distance_mm: float, board: TargetSpec = BOARD
) -> np.ndarray:
    """T_camera_target of a board near the middle of the image."""
    about = rng.uniform(-math.pi, math.pi)
    R = so3_exp(math.radians(tilt_deg) * np.array([math.cos(about), math.sin(about), 0.0]))
    R = R @ so3_exp(np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi)]))
    middle = np.array([*rng.uniform(-0.1, 0.1, 2) * distance_mm, distance_mm])
    return transform(R, middle - R @ board.points_target().mean(axis=0))


def look(
    rng: np.random.Generator, T: np.ndarray, sigma_px: float = SIGMA, board: TargetSpec = BOARD
) -> GridPoints:
    exact = project(transform_points(T, board.points_target()), CAMERA)
    row, column = (a.ravel() for a in np.mgrid[0 : board.rows, 0 : board.columns])
    noisy = exact + rng.normal(0.0, sigma_px, exact.shape)
    return GridPoints(board, 2448, 2050, column, row, noisy, np.full(len(exact), sigma_px))


def tilt_error_deg(T: np.ndarray, true: np.ndarray) -> float:
    return math.degrees(math.acos(min(1.0, float(T[:3, 2] @ true[:3, 2]))))


def test_the_mirrored_tilt_is_a_rotation_and_its_own_inverse() -> None:
    rng = np.random.default_rng(1)
    R = np.array([so3_exp(rng.normal(size=3)) for _ in range(5)])
    t = rng.normal(size=(5, 3)) + np.array([0.0, 0.0, 9.0])
    turned = mirrored(R, t)
    np.testing.assert_allclose(
        turned @ np.swapaxes(turned, 1, 2), np.broadcast_to(np.eye(3), (5, 3, 3)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(turned), 1.0)
    np.testing.assert_allclose(mirrored(turned, t), R, atol=1e-12)
    sight = t / np.linalg.norm(t, axis=1, keepdims=True)
    # The normal goes to the other side of the line of sight; seen along it, points of the plane stay where they were.
    np.testing.assert_allclose(
        turned[:, :, 2] + R[:, :, 2], 2.0 * np.sum(sight * R[:, :, 2], axis=1)[:, None] * sight, atol=1e-12
    )
    across = np.eye(3) - sight[:, :, None] * sight[:, None, :]
    np.testing.assert_allclose((across @ turned)[:, :, :2], (across @ R)[:, :, :2], atol=1e-12)


def test_the_descent_ends_where_the_gradient_vanishes_and_counts_what_it_says() -> None:
    rng = np.random.default_rng(2)
    points = look(rng, tilted(rng, 25.0, 3000.0))
    found = calibrate_points(points, intrinsics=CAMERA)
    target, centroid = centred(points)
    R = found.T_camera_target[:3, :3]
    view = View(CAMERA.as_array(), R, R @ centroid + found.T_camera_target[:3, 3])
    cost = float(np.sum((found.residuals_px / SIGMA) ** 2))
    away = View(view.parameters, so3_exp(np.array([0.05, -0.03, 0.02])) @ R, view.translation_mm * 1.05)
    end, reached = descend(
        np.ascontiguousarray(target.T),
        np.ascontiguousarray(points.points_px.T),
        np.full(len(points), 1.0 / SIGMA),
        away,
        30,
        known_cost=0.0,
        share=0.0,
        least=1e-12,
    )
    assert np.linalg.norm(so3_log(end.rotation @ R.T)) < 1e-6
    assert reached == pytest.approx(cost, rel=1e-8)
    residuals, _ = view_residuals(points, free=False)(end)
    assert reached == pytest.approx(float(np.sum((residuals / SIGMA) ** 2)), rel=1e-12)


def test_a_near_and_large_board_has_no_second_pose_and_a_far_one_does() -> None:
    rng = np.random.default_rng(3)
    near = calibrate_points(look(rng, tilted(rng, 5.0, 350.0)), intrinsics=CAMERA)
    assert near.observability.ambiguity_log_likelihood_ratio is None
    middling = calibrate_points(look(rng, tilted(rng, 30.0, 1500.0)), intrinsics=CAMERA)
    assert middling.observability.ambiguity_log_likelihood_ratio is not None
    assert middling.observability.ambiguity_log_likelihood_ratio > 50.0
    far = calibrate_points(look(rng, tilted(rng, 30.0, 4500.0, SMALL), FAR_SIGMA, SMALL), intrinsics=CAMERA)
    assert far.observability.ambiguity_log_likelihood_ratio is not None
    assert far.observability.ambiguity_log_likelihood_ratio < 5.0
    assert [w.code for w in far.warnings if w.code == "pose_ambiguous"]
    assert not [w.code for w in middling.warnings if w.code == "pose_ambiguous"]


def test_a_plane_seen_squarely_has_its_two_tilts_within_the_noise() -> None:
    """What the stated covariance covers is no second pose."""
    rng = np.random.default_rng(4)
    warned = 0
    for _ in range(40):
        found = calibrate_points(look(rng, tilted(rng, 0.0, 900.0)), intrinsics=CAMERA)
        warned += any(w.code == "pose_ambiguous" for w in found.warnings)
    assert warned == 0


def views(seed: int, count: int) -> list[tuple[Any, Any]]:
    """Calibrations of far boards, some of which the perspective determines and some not, with the truth."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        T = tilted(rng, rng.uniform(10.0, 50.0), rng.uniform(1000.0, 4500.0), SMALL)
        found.append((T, calibrate_points(look(rng, T, FAR_SIGMA, SMALL), intrinsics=CAMERA)))
    return found


def test_the_better_pose_is_taken_and_a_certain_one_is_right() -> None:
    count = 400
    wrong, ambiguous, warned_rightly, certain = 0, 0, 0, 0
    for T, found in views(5, count):
        flipped = tilt_error_deg(found.T_camera_target, T) > tilt_error_deg(
            transform(mirrored(T[:3, :3], found.T_camera_target[:3, 3]), T[:3, 3]), found.T_camera_target
        )
        warned = any(w.code == "pose_ambiguous" for w in found.warnings)
        ambiguous += warned
        certain += not warned
        wrong += flipped and not warned
        warned_rightly += flipped and warned
        # No pose is kept whose opposite fits better: the truth never does by more than its six parameters explain.
        exact = project(transform_points(T, SMALL.points_target()), CAMERA)
        at_truth = float(np.sum((found.points.points_px - exact) ** 2))
        reached = float(np.sum(found.residuals_px**2))
        assert reached <= at_truth
    assert ambiguous > 20
    assert warned_rightly > 5
    assert certain > 100
    # At most one in a thousand of the worst placed: of Poisson's law with mean .4, three are seen once in a thousand.
    assert wrong <= 400 * FALSE_CHOICE + 2


def is_flipped(T: np.ndarray, true: np.ndarray) -> bool:
    """Whether a pose is much nearer to the mirrored tilt than to the true one."""
    other = mirrored(true[:3, :3], T[:3, :3] @ SMALL.points_target().mean(axis=0) + T[:3, 3])
    return math.acos(min(1.0, float(T[:3, 2] @ other[:, 2]))) < 0.5 * math.radians(tilt_error_deg(T, true))


@pytest.mark.parametrize("count", [300, pytest.param(1500, marks=pytest.mark.slow)])
def test_where_the_two_tilts_merge_a_certain_pose_is_right(count: int) -> None:
    """Boards that are hardly tilted, seen from afar: the valley of the one minimum may reach over to the other tilt."""
    rng = np.random.default_rng(10)
    wrong, ambiguous, rightly = 0, 0, 0
    for _ in range(count):
        T = tilted(rng, rng.uniform(0.0, 15.0), rng.uniform(1000.0, 3300.0), SMALL)
        found = calibrate_points(look(rng, T, float(rng.choice([0.02, 0.1])), SMALL), intrinsics=CAMERA)
        warned = any(w.code == "pose_ambiguous" for w in found.warnings)
        flipped = is_flipped(found.T_camera_target, T)
        wrong += flipped and not warned
        ambiguous += warned
        rightly += flipped and warned
        ratio = found.observability.ambiguity_log_likelihood_ratio
        assert not warned or ratio is not None
    print(f"wrong {wrong}, ambiguous {ambiguous}, rightly {rightly}")
    # Of Poisson's law with mean 1.5, five are seen once in fifty; with mean 0.3, three once in three hundred.
    assert wrong <= count * FALSE_CHOICE + 2.5
    assert rightly > count / 75
    assert ambiguous < 0.36 * count


def test_a_descent_that_leads_back_leaves_the_mirrored_tilt_to_be_ruled_out() -> None:
    rng = np.random.default_rng(11)
    squarely = so3_exp(np.array([0.001, 0.0, 0.0]))
    middle = squarely @ BOARD.points_target().mean(axis=0)
    points = look(rng, transform(squarely, np.array([0.0, 0.0, 900.0]) - middle), SIGMA)
    found = calibrate_points(points, intrinsics=CAMERA)
    view, other = pose_in_view(found), second_of(points, found)
    assert other is not None
    assert not other.is_minimum
    np.testing.assert_allclose(
        other.view.rotation[:, 2], mirrored(view.rotation, view.translation_mm)[:, 2], atol=1e-12
    )
    residuals, jacobian = view_residuals(points, free=False)(other.view)
    assert other.cost == pytest.approx(float(np.sum((residuals / SIGMA) ** 2)), rel=1e-12)
    assert other.cost > cost_of(found)
    # All but the tilt is at its best: turned about its normal, or moved, the board fits no better.
    normal = other.view.rotation[:, 2]
    along = np.vstack([np.tensordot(normal, jacobian[:3], axes=1)[None], jacobian[3:]])
    slope = np.tensordot(along, residuals, axes=2)
    gain = slope @ np.linalg.solve(np.tensordot(along, along, axes=([1, 2], [1, 2])), slope) / SIGMA**2
    assert gain < 0.01
    # It is no figure of an image that rules it out, or holds it in its uncertainty.
    assert found.observability.ambiguity_log_likelihood_ratio is None
    # Nor is it anything at all where the perspective is plain.
    near = look(rng, tilted(rng, 10.0, 350.0), SIGMA)
    assert second_of(near, calibrate_points(near, intrinsics=CAMERA)) is None


def test_a_start_at_the_wrong_pose_is_corrected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever of the two a closed form begins at, the fit ends at the better one."""
    from core.calibration import single_image

    plain = pose_from_undistorted_points

    started = []

    def wrong(camera: Camera, points: GridPoints) -> View:
        view = plain(camera, points)
        started.append(view)
        return View(
            view.parameters,
            np.ascontiguousarray(mirrored(view.rotation, view.translation_mm)),
            view.translation_mm,
        )

    rng = np.random.default_rng(6)
    for _ in range(20):
        points = look(rng, tilted(rng, 30.0, 2500.0))
        expected = calibrate_points(points, intrinsics=CAMERA)
        with monkeypatch.context() as patched:
            patched.setattr(single_image, "pose_from_undistorted_points", wrong)
            found = calibrate_points(points, intrinsics=CAMERA)
        assert np.linalg.norm(so3_log(found.pose.rotation.T @ expected.pose.rotation)) < 1e-4
        assert found.observability.ambiguity_log_likelihood_ratio == pytest.approx(
            expected.observability.ambiguity_log_likelihood_ratio, rel=0.02
        )
    assert len(started) == 20


def test_with_a_stated_lens_camera_and_pose_follow_the_better_tilt() -> None:
    """The prior lets a view through that shows perspective by itself no better than a few per cent."""
    rng = np.random.default_rng(7)
    lens = Lens(8.0, 8000.0 / 2320.0)
    wrong, certain, ambiguous = 0, 0, 0
    for _ in range(40):
        T = tilted(rng, 25.0, rng.uniform(1200.0, 2500.0))
        try:
            found = calibrate_points(look(rng, T, 0.1), lens=lens)
        except FocalNotObservable:
            continue
        flipped = tilt_error_deg(found.T_camera_target, T) > 25.0
        warned = any(w.code == "pose_ambiguous" for w in found.warnings)
        ambiguous += warned
        certain += not warned
        wrong += flipped and not warned
    assert wrong == 0
    assert certain >= 5


def test_evidence_needs_more_where_the_noise_is_known_from_few_points() -> None:
    assert needed_evidence(1e6) == pytest.approx(3.09, abs=0.01)
    assert needed_evidence(4.0) > 7.0


def test_the_sign_of_the_evidence_says_which_pose_is_better() -> None:
    rng = np.random.default_rng(8)
    points = look(rng, tilted(rng, 30.0, 2500.0))
    other = second_of(points, calibrate_points(points, intrinsics=CAMERA))
    assert other is not None
    assert other.evidence > needed_evidence(200.0)
    back = second_pose(points, other.view, np.ones(len(points), dtype=np.bool_), other.cost, 1.0)
    assert back is not None
    assert back.evidence == pytest.approx(-other.evidence, rel=0.01)
    assert back.ratio == pytest.approx(other.ratio, rel=0.02)
