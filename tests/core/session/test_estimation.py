"""The order of poses, one estimate for all that needs it, and what is refused."""

from __future__ import annotations

import dataclasses
import math
import random

import numpy as np
import pytest

from core.calibration.multi_view.board_symmetry import quarter_turns, symmetry_rotations, turned_cells
from core.errors import IntrinsicsMissing, TooFewMeasurements, TooManyMeasurements
from core.geometry.camera import Camera, project
from core.geometry.se3 import invert, transform_points
from core.session import ImageObservation, SessionData, estimate_session, group_views, natural
from core.session.estimate import TURNED_ADVICE
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.simulated_views import draw_pose

CAMERA = Camera(1160.0, 1160.3, 605.0, 515.0, -0.1, 0.05, 1e-4, -2e-4)
SIZE = (1224, 1024)
BOARD = TargetSpec("chessboard", 9, 6, 12.0)
SYMMETRIC = TargetSpec("chessboard", 10, 6, 12.0)
SQUARE = TargetSpec("circles", 7, 7, 12.0)


def seen(
    rng: np.random.Generator, board: TargetSpec, T_camera_target: np.ndarray, camera: Camera = CAMERA
) -> GridPoints:
    row, column = (a.ravel() for a in np.mgrid[0 : board.rows, 0 : board.columns])
    px = project(transform_points(T_camera_target, board.points_target()), camera)
    return GridPoints(board, *SIZE, column, row, px + rng.normal(0.0, 0.02, px.shape), np.full(len(px), 0.02))


def session(
    board: TargetSpec, views: dict[str, list[GridPoints]], *, labelling: str = "absolute"
) -> SessionData:
    images = [
        ImageObservation(
            f"{pose_id}.{cycle}",
            pose_id,
            cycle,
            f"{pose_id}.{cycle}",
            0,
            "default",
            None,
            view.image_width_px,
            view.image_height_px,
            labelling=labelling,
        )
        for pose_id, of_pose in views.items()
        for cycle, view in enumerate(of_pose, 1)
    ]
    points = dict(enumerate(view for of_pose in views.values() for view in of_pose))
    return SessionData((board,), ("board",), tuple(images), group_views(images, points))


def drawn(
    seed: int, board: TargetSpec, poses: int, cycles: int
) -> tuple[dict[str, np.ndarray], dict[str, list[GridPoints]]]:
    rng = np.random.default_rng(seed)
    T = {f"P{i}": draw_pose(rng, board, CAMERA, SIZE[0], math.radians(30.0)) for i in range(poses)}
    return T, {pose_id: [seen(rng, board, one) for _ in range(cycles)] for pose_id, one in T.items()}


def test_poses_are_sorted_as_people_count() -> None:
    names = ["1", "2", "10", "10.1", "A", "P1", "P1.2", "P1.10", "P01", "P2", "P2b", "P10", "a"]
    order = sorted(names, key=natural)
    assert sorted(random.Random(1).sample(names, len(names)), key=natural) == order
    assert len({natural(name) for name in names}) == len(names)  # P1 and P01 are one number and two poses
    for before, after in (
        ("1", "2"),
        ("2", "10"),
        ("P2", "P10"),
        ("P1.2", "P1.10"),
        ("P1", "P2b"),
        ("P01", "P2"),
    ):
        assert order.index(before) < order.index(after)


@pytest.mark.parametrize("board", [SYMMETRIC, SQUARE])
def test_the_labels_of_an_estimate_are_one_for_all_images(board: TargetSpec) -> None:
    """Images turned by chance: the estimate's views are the same points under labels that fit its poses."""
    rng = np.random.default_rng(3)
    true, views = drawn(3, board, 3, 4)
    turns = quarter_turns(board)
    given = {}
    for pose_id, of_pose in views.items():
        given[pose_id] = []
        for view in of_pose:
            quarter = turns[int(rng.integers(len(turns)))]
            column, row = turned_cells(board, view.column, view.row, quarter)
            given[pose_id].append(dataclasses.replace(view, column=column, row=row))
    estimate = estimate_session(session(board, given, labelling="up_to_symmetry"))
    (group,) = estimate.groups
    assert len(group.poses) == 12
    assert len(set(group.quarters.tolist())) > 1
    for k, pose in enumerate(group.poses):
        view = group.views.view(k)
        assert pose.rotation is not None
        points_camera = (view.points_target - pose.position_mm) @ pose.rotation
        left = view.points_px - project(points_camera, Camera.from_array(group.estimate.cameras[k]))
        assert np.sqrt(np.mean(left**2)) < 0.03  # px; the noise is 0.02, a wrong label is worth hundreds
        at = given[pose.pose_id][int(pose.cycle or 0) - 1]
        assert sorted(map(tuple, view.points_px.tolist())) == sorted(map(tuple, at.points_px.tolist()))
        # T_image_labelled ties the labels of the image to those of the estimate.
        turn = symmetry_rotations(board)[turns.index(int(group.quarters[k]))]
        places = dict(zip(map(tuple, at.points_px.tolist()), at.points_target, strict=True))
        in_image = np.array([places[tuple(px)] for px in view.points_px.tolist()])
        np.testing.assert_allclose(transform_points(invert(turn), in_image), view.points_target, atol=1e-9)
    # Visits to a pose read one orientation.
    for pose_id in true:
        rotations = [pose.rotation for pose in group.poses if pose.pose_id == pose_id]
        assert all(np.trace(rotations[0].T @ R) > 2.99 for R in rotations if rotations[0] is not None)


def test_the_fit_of_an_estimate_has_its_labels() -> None:
    _, views = drawn(5, SYMMETRIC, 3, 2)
    given = {}
    for i, (pose_id, of_pose) in enumerate(views.items()):
        column, row = turned_cells(SYMMETRIC, of_pose[0].column, of_pose[0].row, 2 * (i % 2))
        given[pose_id] = [dataclasses.replace(view, column=column, row=row) for view in of_pose]
    spoiled = given["P1"][0].points_px
    spoiled[7] += 3.0
    (group,) = estimate_session(session(SYMMETRIC, given, labelling="up_to_symmetry")).groups
    assert 0 < np.count_nonzero(group.quarters) < len(group.quarters)
    fit = group.estimate.fit
    assert fit is not None
    for k in range(len(group.poses)):
        part, at = fit.views.part(k), fit.placements.view(k)
        np.testing.assert_array_equal(fit.views.points_px[part], group.views.points_px[group.views.part(k)])
        arms = fit.views.points_target[part] - fit.views.centroids[k]
        seen_px = project(arms @ at.rotation.T + at.translation_mm, Camera.from_array(at.parameters))
        used = fit.used[part]
        assert np.sqrt(np.mean((fit.views.points_px[part] - seen_px)[used] ** 2)) < 0.03
        rejected = fit.views.points_px[part][~used]
        assert len(rejected) == (group.poses[k].pose_id == "P1")  # in both images of the pose
        assert np.all(np.abs(rejected - spoiled[7]) < 4.0)
    few = fit.take(np.array([1, 3]))
    np.testing.assert_array_equal(
        few.views.points_px[few.views.part(1)], fit.views.points_px[fit.views.part(3)]
    )
    np.testing.assert_array_equal(few.used[few.views.part(1)], fit.used[fit.views.part(3)])


def test_what_cannot_be_estimated_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    _, views = drawn(4, BOARD, 1, 1)
    data = session(BOARD, views)
    with pytest.raises(TooFewMeasurements):
        estimate_session(dataclasses.replace(data, images=(), views=()))
    with pytest.raises(IntrinsicsMissing):
        estimate_session(data, "given")
    monkeypatch.setattr("core.session.estimation.session_estimate.MAX_POINTS", BOARD.size - 1)
    with pytest.raises(TooManyMeasurements):
        estimate_session(data)


@pytest.mark.parametrize("zoomed", [False, True])
def test_images_of_another_setting_of_the_lens_are_named(zoomed: bool) -> None:
    rng = np.random.default_rng(31)
    T, views = drawn(31, BOARD, 6, 3)
    if zoomed:
        for pose_id, one in T.items():
            views[pose_id][2] = seen(rng, BOARD, one, dataclasses.replace(CAMERA, fx_px=1310.0, fy_px=1310.3))
    found = estimate_session(session(BOARD, views))
    assert len(found.excluded) == (6 if zoomed else 0)
    assert ("camera_settings_mixed" in {w.code for w in found.warnings}) == zoomed


@pytest.mark.parametrize("code", ["camera_settings_mixed", "image_size_differs"])
def test_turned_images_are_to_be_uploaded_as_they_were(code: str) -> None:
    """In a focus group of their own the robot would seem to turn by as much as the images."""
    _, views = drawn(33, BOARD, 6, 3)
    width, height = SIZE if code == "camera_settings_mixed" else SIZE[::-1]
    for of_pose in views.values():
        u, v = of_pose[2].points_px.T
        turned = np.column_stack([SIZE[1] - 1 - v, u])
        of_pose[2] = dataclasses.replace(
            of_pose[2], image_width_px=width, image_height_px=height, points_px=turned
        )
    data = session(BOARD, views)
    warned = {w.code: w.advice or "" for w in estimate_session(data).warnings}
    for found in (code, "images_excluded"):
        assert TURNED_ADVICE in warned[found]


def test_spoilt_images_are_of_no_other_setting_of_the_lens() -> None:
    rng = np.random.default_rng(32)
    _, views = drawn(32, BOARD, 6, 3)
    for of_pose in views.values():
        off = rng.normal(0.0, 15.0, of_pose[2].points_px.shape)
        of_pose[2] = dataclasses.replace(of_pose[2], points_px=of_pose[2].points_px + off)
    found = estimate_session(session(BOARD, views))
    assert len(found.excluded) == 6
    assert "camera_settings_mixed" not in {w.code for w in found.warnings}
