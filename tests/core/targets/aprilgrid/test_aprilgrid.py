"""AprilGrids: named by their tags, refined by their corners, whatever is hidden or out of view."""

from __future__ import annotations

import dataclasses
import math
import re

import cv2
import numpy as np
import pytest

from core import calibrate_image
from core.errors import TargetMirrored, TargetMismatch, TargetNotFound
from core.simulation import Light
from core.targets import detect
from core.targets.aprilgrid.assembly import TagGrid
from core.targets.aprilgrid.layout import aprilgrid_layout
from core.targets.aprilgrid.tag_edge import estimate_tag_edge
from core.targets.specification import TargetSpec
from tests.support.image.tilted_sheets import CAMERA, Shot, errors, take, tilted_scene, truth_px
from tests.support.simulation.renders import render

GRID = TargetSpec("aprilgrid", 5, 4, 32.5, 25.0)


@pytest.fixture(scope="module")
def shot() -> Shot:
    return take(GRID)


@pytest.mark.parametrize(
    ("columns", "rows", "gap", "turn", "tilt_deg"),
    [
        (5, 4, 0.3, 0.3, 0.0),
        (4, 4, 0.3, -1.4, 20.0),
        (3, 5, 0.25, 2.0, 40.0),
        (5, 4, 0.3, 3.1, 60.0),
        (4, 3, 0.6, 0.8, 30.0),
    ],
)
def test_every_corner_is_found_and_named_whichever_way_the_grid_lies(
    columns: int, rows: int, gap: float, turn: float, tilt_deg: float
) -> None:
    target = TargetSpec("aprilgrid", columns, rows, 25.0 * (1.0 + gap), 25.0)
    count, rms, stated = errors(*take(target, turn=turn, tilt_deg=tilt_deg))
    assert count == target.size
    assert rms < 0.03
    # rms of 2 n values that should be standard normal: three of its standard deviations, and a tenth
    assert abs(stated - 1.0) < 0.1 + 3.0 / math.sqrt(4.0 * count)


def test_the_image_of_another_program_is_read_the_same_way(shot: Shot) -> None:
    """Bits from the family's published code words, cell by cell with ids from the lower left: no code of ours."""
    cell = 12  # px; a gap is three cells
    sheet = np.full((20 * cell + 26 * cell, 20 * cell + 39 * cell), 255, np.uint8)
    codes = [0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822, 0xF31DAB3AC]
    for k, code in enumerate(codes):
        i, up = k % 3, k // 3
        left, top = (10 + 13 * i) * cell, (10 + 13 * (1 - up)) * cell
        sheet[top : top + 10 * cell, left : left + 10 * cell] = 0
        for bit in range(36):
            y, x = divmod(bit, 6)
            if code >> (35 - bit) & 1:
                v, u = top + (2 + y) * cell, left + (2 + x) * cell
                sheet[v : v + cell, u : u + cell] = 255
        for u, v in ((-3, -3), (10, -3), (-3, 10), (10, 10)):
            sheet[top + v * cell : top + (v + 3) * cell, left + u * cell : left + (u + 3) * cell] = 0
    found = detect(cv2.GaussianBlur(sheet, (0, 0), 1.2), TargetSpec("aprilgrid", 3, 2, 13.0, 10.0))
    assert len(found) == 24
    x, y = found.points_target[:, :2].T  # Kalibr's x is W - x, its y counts upward from the lower left
    kalibr = np.stack([36.0 - x, 23.0 - y], axis=1)
    expected = (10.0 + kalibr) * cell - 0.5
    assert np.abs(found.points_px - expected).max() < 0.02


def test_depth_makes_no_difference(shot: Shot) -> None:
    _, image = shot
    found = detect(image, GRID)
    deep = detect(image.astype(np.uint16) * 257, GRID)
    np.testing.assert_array_equal(found.column, deep.column)
    np.testing.assert_allclose(found.points_px, deep.points_px, atol=2e-3)


def test_an_image_gives_camera_and_pose(shot: Shot) -> None:
    """The frame is the usual one: the camera before the board, at negative z, and where the scene has it."""
    taken, image = shot
    result = calibrate_image(cv2.imencode(".png", image)[1].tobytes(), GRID)
    expected = -taken.T_camera_target[:3, :3].T @ taken.T_camera_target[:3, 3]
    assert expected[2] < 0.0
    off = result.pose.position_mm - expected
    assert np.linalg.norm(off) < 0.02 * np.linalg.norm(expected)
    assert (
        abs(result.camera.fx_px / CAMERA.fx_px - 1.0)
        < 4.0 * result.camera_standard_uncertainty[0] / CAMERA.fx_px
    )


@pytest.mark.parametrize(
    ("part", "least"),
    [(np.s_[:, 820:], 40), (np.s_[:, 560:], 16), (np.s_[430:, :], 20), (np.s_[380:560, :], 28)],
)
def test_what_is_hidden_costs_points_and_is_said(shot: Shot, part: tuple[slice, slice], least: int) -> None:
    taken, image = shot
    hidden = image.copy()
    hidden[part] = 120
    found = detect(hidden, GRID)
    assert least <= len(found) < GRID.size
    off = found.points_px - truth_px(taken, found)
    assert np.abs(off).max() < 0.15
    assert [w.code for w in found.warnings] == ["points_missing"]


def test_cables_and_highlights_move_nothing(shot: Shot) -> None:
    taken, image = shot
    spoiled = image.copy()
    cv2.line(spoiled, (250, 100), (1000, 800), 20, 25, cv2.LINE_AA)
    cv2.line(spoiled, (300, 800), (1100, 300), 230, 12, cv2.LINE_AA)
    cv2.circle(spoiled, (700, 400), 90, 255, -1, cv2.LINE_AA)
    found = detect(spoiled, GRID)
    assert len(found) >= 24
    off = found.points_px - truth_px(taken, found)
    assert np.abs(off).max() < 0.2


@pytest.mark.parametrize("stated_mm", [18.0, 21.5, 24.0, 24.5, 25.5, 26.0, 28.0])
@pytest.mark.parametrize("turn", [0.3, 2.5])
def test_another_edge_of_tags_than_stated_is_refused_with_the_right_one(
    stated_mm: float, turn: float
) -> None:
    _, image = take(GRID, turn=turn, tilt_deg=45.0, depth_mm=450.0)
    with pytest.raises(TargetMismatch, match=r"edge is 0\.7[67]\d? of") as caught:
        detect(image, dataclasses.replace(GRID, marker_mm=stated_mm))
    said = re.search(r"pitch_mm 32.5, marker_mm is probably ([\d.]+)\. ", caught.value.advice)
    assert said is not None
    assert float(said[1]) == pytest.approx(25.0, abs=0.15)


def test_the_edge_of_tags_is_estimated_with_its_uncertainty() -> None:
    """From corners with noise, under distortion, some of them astray."""
    layout = aprilgrid_layout(GRID)
    column, row = (a.ravel() for a in np.meshgrid(np.arange(10), np.arange(8)))
    wider = dataclasses.replace(GRID, marker_mm=25.4)
    scene = tilted_scene(wider, tilt_deg=40.0)
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        points = scene.points_px + rng.normal(0.0, 0.2, (80, 2))
        points[rng.choice(80, 6, replace=False)] += rng.uniform(3.0, 6.0, (6, 2))
        edge = estimate_tag_edge(layout, column, row, points)
        ratios.append((edge.excess_mm - 0.4) / edge.standard_uncertainty_mm)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.4)


def test_few_tags_do_not_determine_their_edge() -> None:
    layout = aprilgrid_layout(GRID)
    column, row = (a.ravel() for a in np.meshgrid(np.arange(4), np.arange(2)))
    points = tilted_scene(GRID).points_px[row * 10 + column]
    assert estimate_tag_edge(layout, column, row, points).standard_uncertainty_mm == math.inf


@pytest.mark.parametrize("turn", [-1.5, -0.5, 1.4])
def test_a_tag_far_from_the_others_does_not_make_the_lens_s_distortion_a_width(turn: float) -> None:
    """Where papers hide the rest: three tags next to one another and one five rows below, as the lens shows them."""
    target = TargetSpec("aprilgrid", 6, 7, 30.0, 25.0)
    layout = aprilgrid_layout(target)
    points = tilted_scene(target, tilt_deg=40.0, turn=turn).points_px.reshape(14, 12, 2)
    corners = {
        tag: points[[2 * y, 2 * y, 2 * y + 1, 2 * y + 1], [2 * x, 2 * x + 1, 2 * x + 1, 2 * x]]
        for tag, (x, y) in enumerate(layout.tag_places.tolist())
        if (x, y) in [(0, 0), (1, 0), (2, 0), (5, 5)]
    }
    TagGrid(layout, corners).check_tag_edge((5_000, 5_000))  # raises where they look wider than stated


@pytest.mark.parametrize("width_px", [8.0, 10.0, 12.0])
def test_a_lamp_s_spot_costs_the_corners_that_it_covers(width_px: float) -> None:
    taken, image = take(GRID, depth_mm=700.0)
    edge_px = 10.0  # half the gap: so far from a corner its pixels lie
    v, u = np.indices(image.shape)
    first, last = taken.points_px.min(axis=0), taken.points_px.max(axis=0)
    rng = np.random.default_rng(0)
    for place in ((563.0, 446.0), (739.0, 447.0), *rng.uniform(first, last, (6, 2))):
        squares = (u - place[0]) ** 2 + (v - place[1]) ** 2
        spoiled = image + 400.0 * np.exp(-squares / (2.0 * width_px**2))
        found = detect(np.clip(np.rint(spoiled), 0, 255).astype(np.uint8), GRID)
        clear = np.hypot(*(taken.points_px - place).T) > 4.0 * width_px + edge_px
        missing = set(np.flatnonzero(clear)) - set(found.row * GRID.grid_columns + found.column)
        assert len(missing) <= 2  # next to one that went astray


@pytest.mark.parametrize("offset_mm", [95.0, -120.0])
def test_a_grid_partly_out_of_the_image_keeps_its_names(offset_mm: float) -> None:
    taken, image = take(GRID, offset_mm=offset_mm)
    found = detect(image, GRID)
    assert 20 <= len(found) < GRID.size
    off = found.points_px - truth_px(taken, found)
    assert np.abs(off).max() < 0.15


def test_poor_light(shot: Shot) -> None:
    light = Light(6.0, 30.0, gradient=(0.3, 0.2), vignetting=0.4)
    count, rms, stated = errors(*take(GRID, light=light, clutter=0.0))
    assert count >= 0.9 * GRID.size
    assert rms < 0.2
    assert 0.7 < stated < 1.4


def test_no_grid_and_the_mirrored_one(shot: Shot) -> None:
    _, image = shot
    with pytest.raises(TargetNotFound, match="No tag"):
        detect(np.full((400, 300), 128, np.uint8), GRID)
    for mirrored in (image[:, ::-1], image[::-1], image.T):
        with pytest.raises(TargetMirrored):
            detect(np.ascontiguousarray(mirrored), GRID)


def test_another_board_is_not_taken_for_it(shot: Shot) -> None:
    _, image = shot
    for columns, rows in ((4, 5), (4, 4), (6, 4), (5, 3)):
        with pytest.raises(TargetMismatch, match=f"{columns} x {rows}"):
            detect(image, TargetSpec("aprilgrid", columns, rows, 32.5, 25.0))
    board = TargetSpec("chessboard", 9, 6, 20.0)
    with pytest.raises(TargetNotFound, match="No tag"):
        detect(render(tilted_scene(board)), GRID)
    with pytest.raises(TargetNotFound):
        detect(image, board)


def test_two_sheets_with_the_same_tags_are_a_mismatch(shot: Shot) -> None:
    _, image = shot
    with pytest.raises(TargetMismatch, match="do not fit the grid found"):
        detect(np.hstack([image, image]), GRID)


def test_tags_too_small_to_measure_are_refused_with_their_least_size() -> None:
    _, image = take(GRID, depth_mm=2400.0, tilt_deg=0.0, clutter=0.0)
    with pytest.raises(TargetNotFound) as refusal:
        detect(image, GRID)
    assert "25 px" in str(refusal.value.advice)


def test_a_sheet_of_fewer_rows_keeps_its_names(shot: Shot) -> None:
    """Where a tag is does not depend on the rows the target is said to have; nor are any taken for seen."""
    taken, image = shot
    found = detect(image, TargetSpec("aprilgrid", 5, 6, 32.5, 25.0))
    assert found.row.max() < GRID.grid_rows
    assert len(found) > 0.95 * GRID.size
    assert np.abs(found.points_px - truth_px(taken, found)).max() < 0.1


def test_one_row_of_tags_does_not_prove_how_many_columns_there_are(shot: Shot) -> None:
    taken, image = shot
    mask = np.zeros_like(image)
    outline = np.rint(taken.points_px.reshape(8, 10, 2)[[0, 0, 1, 1], [0, 9, 9, 0]]).astype(np.int32)
    cv2.fillConvexPoly(mask, outline, 255)
    row = np.where(cv2.dilate(mask, np.ones((25, 25))) > 0, image, 90)
    for columns in (5, 6):
        with pytest.raises(TargetNotFound, match="one row"):
            detect(row, TargetSpec("aprilgrid", columns, 4, 32.5, 25.0))
