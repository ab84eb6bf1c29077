"""Groups of images under weak perspective: one tilt for all images of a pose, the better one, or none."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from core.calibration import state
from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.group_estimate import GroupEstimate
from core.calibration.planar_ambiguity import mirrored
from core.calibration.residuals import View
from core.errors import PoseAmbiguous
from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform, transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_pose

CAMERA = Camera(2320.0, 2321.0, 1220.0, 1028.0, -0.1, 0.05, 1e-4, -1e-4)
SMALL = TargetSpec("chessboard", 6, 5, 10.0)
SIGMA = 0.15


def far(rng: np.random.Generator, distance_mm: float) -> np.ndarray:
    """T_camera_target of a small board tilted by some 30°, seen from afar."""
    about = rng.uniform(-math.pi, math.pi)
    R = so3_exp(rng.uniform(0.45, 0.6) * np.array([math.cos(about), math.sin(about), 0.0]))
    R = R @ so3_exp(np.array([0.0, 0.0, rng.uniform(-0.3, 0.3)]))
    middle = np.array([*rng.uniform(-0.1, 0.1, 2) * distance_mm, distance_mm])
    return transform(R, middle - R @ SMALL.points_target().mean(axis=0))


def look(rng: np.random.Generator, T: np.ndarray, sigma_px: float = SIGMA) -> GridPoints:
    exact = project(transform_points(T, SMALL.points_target()), CAMERA)
    row, column = (a.ravel() for a in np.mgrid[0 : SMALL.rows, 0 : SMALL.columns])
    noisy = exact + rng.normal(0.0, sigma_px, exact.shape)
    return GridPoints(SMALL, 2448, 2050, column, row, noisy, np.full(len(exact), sigma_px))


def session(
    seed: int, distances_mm: list[float], cycles: int
) -> tuple[list[GridPoints], list[int], list[np.ndarray]]:
    rng = np.random.default_rng(seed)
    poses = [far(rng, distance) for distance in distances_mm]
    views, labels = [], []
    for _ in range(cycles):
        for label, T in enumerate(poses):
            views.append(look(rng, T))
            labels.append(label)
    return views, labels, poses


def normals(found: GroupEstimate) -> np.ndarray:
    """The board's normal in the camera's frame, image by image."""
    return found.rotations[:, 2, :]


def right(found: GroupEstimate, labels: list[int], poses: list[np.ndarray]) -> np.ndarray:
    """Return of each image whether its tilt is nearer to the true one than to the mirrored."""
    true = np.array([poses[labels[i]] for i in found.images])
    other = mirrored(true[:, :3, :3], true[:, :3, 3])
    seen = normals(found)
    return np.sum(seen * true[:, :3, 2], axis=1) > np.sum(seen * other[:, :, 2], axis=1)


@pytest.mark.parametrize("estimator", ["given", "pooled"])
def test_images_of_a_pose_decide_together(estimator: str) -> None:
    """One image alone often fits the wrong tilt better; fifteen of a pose do not, and none of them is left in it."""
    views, labels, poses = session(1, [2000.0, 2200.0, 2400.0, 2600.0], 15)
    rng = np.random.default_rng(9)
    near = TargetSpec("chessboard", 14, 10, 10.0)
    for label in range(4, 12):  # poses of another board, near by, that determine the camera
        T = draw_pose(rng, near, CAMERA, 2448, math.radians(30.0))
        px = project(transform_points(T, near.points_target()), CAMERA) + rng.normal(
            0.0, 0.05, (near.size, 2)
        )
        row, column = (a.ravel() for a in np.mgrid[0 : near.rows, 0 : near.columns])
        views.append(GridPoints(near, 2448, 2050, column, row, px, np.full(near.size, 0.05)))
        labels.append(label)
        poses.append(T)
    found = estimate_group(views, estimator, intrinsics=CAMERA, repeats=labels)
    assert right(found, labels, poses).all()
    of_pose = np.array(labels)[found.images]
    # Whole poses are in or out; those with images that are in, with all of them.
    assert {int(np.sum(of_pose == label)) for label in range(4)} <= {0, 15}
    assert sum(int(np.any(of_pose == label)) for label in range(4)) >= 2
    assert all(failure.code == "pose_ambiguous" for _, failure in found.failures)


def test_a_start_in_the_wrong_tilt_is_found_and_turned(monkeypatch: pytest.MonkeyPatch) -> None:
    views, labels, poses = session(2, [1000.0, 1100.0, 1200.0], 6)
    expected = estimate_group(views, "given", intrinsics=CAMERA, repeats=labels)
    plain = state.place_by_homography

    def wrong(*arguments: Any) -> View:
        view = plain(*arguments)
        R = np.ascontiguousarray(mirrored(view.rotation, view.translation_mm))
        return View(view.parameters, R, view.translation_mm)

    monkeypatch.setattr(state, "place_by_homography", wrong)
    found = estimate_group(views, "given", intrinsics=CAMERA, repeats=labels)
    assert right(found, labels, poses).all()
    np.testing.assert_array_equal(found.images, expected.images)
    np.testing.assert_allclose(found.positions_mm, expected.positions_mm, atol=0.05)


def test_poses_that_cannot_be_determined_are_excluded_by_name() -> None:
    views, labels, poses = session(3, [1000.0, 4500.0, 1100.0], 3)
    found = estimate_group(views, "given", intrinsics=CAMERA, repeats=labels)
    assert {labels[i] for i in found.images} == {0, 2}
    assert right(found, labels, poses).all()
    assert [labels[i] for i, _ in found.failures] == [1, 1, 1]
    for _, failure in found.failures:
        assert failure.code == "pose_ambiguous"
        assert "opposite way" in failure.detail
        assert "nearer" in (failure.advice or "")
    assert len(found.scatter) == len(found.differing) == len(found.images) == 6


def test_where_no_pose_can_be_determined_nothing_is_reported() -> None:
    views, labels, _ = session(4, [4500.0], 2)
    with pytest.raises(PoseAmbiguous):
        estimate_group(views, "given", intrinsics=CAMERA, repeats=labels)


@pytest.mark.parametrize("estimator", ["pooled", "given", "per_image", "per_image_fixed_pp"])
def test_ordinary_views_are_not_ambiguous(estimator: str) -> None:
    """Boards that fill the image, squarely seen ones among them."""
    rng = np.random.default_rng(5)
    board = TargetSpec("chessboard", 9, 6, 12.0)
    views = []
    for tilt in (0.0, 5.0, 15.0, 30.0, 45.0, 30.0):
        T = draw_pose(rng, board, CAMERA, 2448, math.radians(tilt))
        px = project(transform_points(T, board.points_target()), CAMERA) + rng.normal(
            0.0, 0.02, (board.size, 2)
        )
        row, column = (a.ravel() for a in np.mgrid[0 : board.rows, 0 : board.columns])
        views.append(GridPoints(board, 2448, 2050, column, row, px, np.full(board.size, 0.02)))
    found = estimate_group(views, estimator, intrinsics=CAMERA)
    assert "pose_ambiguous" not in {failure.code for _, failure in found.failures}


@pytest.mark.parametrize("seed", range(4, 10))
def test_what_all_images_have_in_common_counts_once(seed: int) -> None:
    """Twenty times the same image say of the tilt no more than one of them, which does not determine it."""
    views, _, _ = session(seed, [4500.0], 1)
    with pytest.raises(PoseAmbiguous):
        estimate_group(views * 20, "given", intrinsics=CAMERA, repeats=[0] * 20)
