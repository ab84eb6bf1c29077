"""Where a board ends: its boundary is distinguished from hidden squares, clutter and the edge of the image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from core.errors import DetectionError
from core.targets import TargetSpec, detect
from core.targets.lattice.board_boundary import bounded
from core.targets.lattice.corner_graph import link
from core.targets.lattice.growing import grow_lattice
from core.targets.lattice.pyramid import Level
from core.targets.lattice.saddle_points import find_saddles
from tests.support.targets.drawn_boards import PITCH, board, lattice_of


def test_ends_are_distinguished_from_parts() -> None:
    image, grid = board(8, 6)
    whole = lattice_of(grid, origin_is_bright=False)
    found = bounded(image, whole)
    assert found is not None
    assert [side.is_boundary for side in found.sides] == [True] * 4
    # a line of corners beyond that was not grown: its squares still alternate, but growing decides on corners there
    gappy = lattice_of(grid.copy(), origin_is_bright=False)
    gappy.grid[0, 1:7], gappy.gap[0, 1:7] = (
        np.nan,
        np.nan,
    )  # two of eight: no line of the board, yet something
    found = bounded(image, gappy)
    assert found is not None
    assert found.size == (8, 5)
    assert found.sides[0].continues
    assert not found.is_whole


def test_corners_of_clutter_beyond_a_board_are_no_line_of_it() -> None:
    """What is in the margin at a corner's place; a line's squares would change their colour there."""
    image, grid = board(8, 6)
    above = 2.0 * grid[0] - grid[1]
    lattice = lattice_of(np.concatenate([above[None], grid]), origin_is_bright=True)
    lattice.grid[0, [0, 1, 2, 5, 6, 7]] = np.nan
    lattice.gap[0, [0, 1, 2, 5, 6, 7]] = np.nan
    found = bounded(image, lattice)
    assert found is not None
    assert found.size == (8, 6)
    assert found.sides[0].is_boundary
    assert found.is_whole


@pytest.mark.parametrize("side", range(4))
def test_an_image_that_ends_with_the_corners_does_not_show_a_whole_board(side: int) -> None:
    image, _ = board(8, 6)  # a margin of two squares, and the outermost one
    part = np.ascontiguousarray(np.rot90(image, side)[:, : -round(2.6 * PITCH)])
    saddles = find_saddles(Level(part, 0))
    patches = link(saddles)
    first = np.flatnonzero(patches.patch == 0)
    found = bounded(part, grow_lattice(part, saddles.points[first].astype(np.float64), patches.place[first]))
    assert found is not None
    assert found.size == (8, 6)
    assert found.continues
    assert not found.is_whole


ENDS = [(5.0, 10, 4, True), (5.0, 10, 3, True), (5.0, 10, 2, False), (5.0, 4, 2, False), (12.0, 4, 2, True)]


@pytest.mark.parametrize(("turn_deg", "rows", "in_view", "ends"), ENDS)
@pytest.mark.parametrize("corner", range(4))
def test_part_of_a_side_shows_where_the_board_ends(
    turn_deg: float, rows: int, in_view: int, ends: bool, corner: int
) -> None:
    """The border cuts the outermost squares of a turned board; two ends suffice where no squares follow there."""
    asked = TargetSpec("chessboard", 8, rows, 20.0)
    for columns in (8, 9):
        image = np.ascontiguousarray(np.rot90(board_cut_aslant(columns, rows, in_view, turn_deg), corner))
        if ends and columns == 8:
            assert len(detect(image, asked)) == 8 * rows
        else:
            with pytest.raises(DetectionError):
                detect(image, asked)


def board_cut_aslant(columns: int, rows: int, in_view: int, turn_deg: float) -> np.ndarray:
    """A turned board, the image cut so that of the places one square right of its eighth column so many are in it."""
    image, grid = board(columns, rows, margin=4)
    turn = cv2.getRotationMatrix2D((0.0, 0.0), turn_deg, 1.0)
    turn[1, 2] = down = 0.25 * image.shape[1]
    size = image.shape[1] + round(0.25 * image.shape[0]), image.shape[0] + round(down)
    turned = cv2.warpAffine(image, turn, size, borderValue=200.0)
    across = (grid[:, 7] + (PITCH, 0.0)) @ turn[:, :2].T + turn[:, 2]
    border = np.sort(across[:, 0])[[in_view - 1, in_view]].mean() + 3.0
    return np.ascontiguousarray(turned[:, : round(border)])


@pytest.mark.parametrize("depth", [0.55, 0.8])
def test_a_board_cut_to_fit_its_plate_is_whole(depth: float) -> None:
    image, grid = board(8, 6)
    image = image.copy()
    image[:, round(grid[0, -1, 0] + depth * PITCH) :] = 200
    image[:, : round(grid[0, 0, 0] - depth * PITCH)] = 200
    found = bounded(image, lattice_of(grid, origin_is_bright=False))
    assert found is not None
    assert found.is_whole


def test_outermost_squares_that_end_unevenly_are_hidden_ones() -> None:
    image, grid = board(8, 6)
    image = image.copy()
    right = grid[:, -1, 0] + np.linspace(0.38, 1.2, 6) * PITCH  # a slanting edge over the last squares
    outline = np.array(
        [[right[0], grid[0, 0, 1] - PITCH], [right[-1], grid[-1, 0, 1] + PITCH], [999, 999], [999, 0]]
    )
    cv2.fillConvexPoly(image, np.rint(outline).astype(np.int32), 200)
    found = bounded(image, lattice_of(grid, origin_is_bright=False))
    assert found is not None
    assert [side.is_boundary for side in found.sides] == [True, True, True, False]
