"""Lattices of corners: linked, grown over what is hidden, and free of kinks."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from core.targets.chessboard.orientation import orient
from core.targets.lattice.board_boundary import bounded
from core.targets.lattice.corner_graph import link
from core.targets.lattice.growing import grow_lattice
from core.targets.lattice.lattice import bent_points
from core.targets.lattice.pyramid import Level
from core.targets.lattice.saddle_points import find_saddles
from tests.support.targets.drawn_boards import PITCH, board, drawn_board


def test_a_lens_makes_no_kinks_and_a_mistake_does() -> None:
    _, grid = board(9, 6)
    y, x = np.mgrid[-1:1:6j, -1:1:9j]
    lens = grid + np.stack([x, y], axis=2) * (x * x + y * y)[..., None] * 10.0
    for smooth in (grid, lens, grid / (1.0 + 2e-3 * grid[..., :1])):
        assert not bent_points(smooth).any()
    wrong = grid.copy()
    wrong[2, 3] += (PITCH / 2, 0.0)
    assert bent_points(wrong)[2, 3]
    assert not bent_points(wrong)[:, 6:].any()
    gappy = grid.copy()
    gappy[1, 4] = np.nan
    assert not bent_points(gappy).any()


@pytest.mark.parametrize("turn", range(4))
def test_links_make_one_patch_in_order(turn: int) -> None:
    image, _ = board(8, 5)
    saddles = find_saddles(Level(np.ascontiguousarray(np.rot90(image, turn)), 0))
    patches = link(saddles)
    assert list(patches.sizes) == [40]
    place = patches.place - patches.place.min(axis=0)
    assert sorted(place.max(axis=0)) == [4, 7]
    assert len(np.unique(place, axis=0)) == 40
    # an affine map takes places to pixels, and does not mirror
    A = np.column_stack([place, np.ones(40)])
    found, *_ = np.linalg.lstsq(A, saddles.points.astype(np.float64), rcond=None)
    np.testing.assert_allclose(A @ found, saddles.points, atol=0.1)
    assert np.linalg.det(found[:2]) > 0.0


def test_faint_texture_between_large_squares_does_not_hide_their_corners() -> None:
    """Wood, paper and JPEG have a hundred faint saddles nearer to a corner than the next one: none is its neighbour."""
    image = drawn_board(6, 4, 60)
    fleck = np.kron(np.array([[8, 0], [0, 8]], np.uint8), np.ones((4, 4), np.uint8))
    image += np.tile(np.pad(fleck, 1), (78, 90))
    saddles = find_saddles(Level(image, 0))
    assert np.median(saddles.contrast) * 10.0 < saddles.contrast.max()
    assert len(saddles) * np.pi * 60.0**2 / image.size > 100.0
    assert link(saddles).sizes[0] == 24


def test_colours_of_places_are_right() -> None:
    image, _ = board(8, 5)
    saddles = find_saddles(Level(image, 0))
    patches = link(saddles)
    for point, place in zip(saddles.points, patches.place, strict=True):
        a = saddles.points[np.argmin(np.abs(patches.place - place - (1, 0)).sum(axis=1))] - point
        b = saddles.points[np.argmin(np.abs(patches.place - place - (0, 1)).sum(axis=1))] - point
        if np.linalg.norm(a) < 1.0 or np.linalg.norm(b) < 1.0:
            continue  # at the end of the board
        u, v = np.rint(point + (a + b) / 2.0).astype(int)
        assert (image[v, u] > 100) == (place.sum() % 2 == 0)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("corner", [(0, 0), (3, 2), (6, 4)])
def test_growing_finds_the_whole_board_and_stops(dtype: type, corner: tuple[int, int]) -> None:
    image, grid = board(8, 6)
    image = image.astype(dtype) * (1 if dtype is np.uint8 else 100)
    i, j = corner
    place = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    points = np.array([grid[j + y, i + x] for x, y in place]) + np.random.default_rng(1).uniform(
        -2, 2, (4, 2)
    )
    if (i + j) % 2 == 0:  # the square there is black: places begin at a bright one
        place = place + np.array([1, 0])
    lattice = grow_lattice(image, points, place)
    np.testing.assert_allclose(lattice.grid, grid, atol=0.05)
    assert not lattice.origin_is_bright
    assert not lattice.outside.any()
    found = bounded(image, lattice)
    assert found is not None
    assert found.is_whole
    assert found.size == (8, 6)


def test_a_part_hidden_is_grown_around_and_missing() -> None:
    image, grid = board(12, 9)
    cv2.circle(image, tuple(np.rint(grid[4, 5]).astype(int).tolist()), 30, 255, -1)
    saddles = find_saddles(Level(image, 0))
    patches = link(saddles)
    first = np.flatnonzero(patches.patch == 0)
    lattice = grow_lattice(image, saddles.points[first].astype(np.float64), patches.place[first])
    if lattice.gap.shape != (9, 12):
        lattice = lattice.quarter_turn()
    lattice = orient(lattice)[0]
    hidden = np.linalg.norm(grid - grid[4, 5], axis=2) < 31
    near = np.linalg.norm(grid - grid[4, 5], axis=2) < 30 + 0.4 * PITCH  # part of whose squares is hidden
    assert not lattice.known[hidden].any()
    assert lattice.known[~near].all()
