"""The judges of a found grid, one by one."""

from __future__ import annotations

import numpy as np
import pytest

from core.targets.lattice import is_smooth, smooth_residuals, spacing
from core.targets.orientation import orient, right_handed
from core.targets.refinement import noise_level, refine
from core.targets.squares import grow, lines_beyond, measure_colours, outer_lines_are_corners

PITCH = 24


def board(columns: int, rows: int, margin: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Return a drawn board (square (-1, -1) black) and its grid, upright."""
    squares = np.ones((rows + 1 + 2 * margin, columns + 1 + 2 * margin), np.float32)
    squares[margin:-margin, margin:-margin] = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2
    image = np.kron(squares, np.ones((PITCH, PITCH), np.float32)) * 180.0 + 20.0
    y, x = np.mgrid[0:rows, 0:columns]
    grid = (np.stack([x, y], axis=2) + margin + 1.0) * PITCH - 0.5
    return image, grid


def test_spacing_is_to_the_nearest_neighbour() -> None:
    _, grid = board(4, 3)
    stretched = grid * np.array([1.0, 1.5])
    np.testing.assert_allclose(spacing(stretched), PITCH)


def test_smooth_grids_pass_and_broken_ones_do_not() -> None:
    _, grid = board(9, 6)
    y, x = np.mgrid[-1:1:6j, -1:1:9j]
    lens = grid + np.stack([x, y], axis=2) * (x * x + y * y)[..., None] * 10.0
    projective = grid / (1.0 + 2e-3 * grid[..., :1])
    assert is_smooth(grid)
    assert is_smooth(lens)
    assert is_smooth(projective)
    shifted = grid.copy()
    shifted[2] += (PITCH / 2, 0.0)  # a row that is half a square off
    assert not is_smooth(shifted)
    swapped = grid.copy()
    swapped[[1, 4]] = swapped[[4, 1]]
    assert not is_smooth(swapped)
    assert not is_smooth(np.full_like(grid, np.nan))
    assert not is_smooth(np.zeros_like(grid))


def test_residuals_of_an_exact_projection_vanish() -> None:
    _, grid = board(5, 4)
    bend, rest = smooth_residuals(grid / (1.0 + 1e-3 * grid[..., 1:]))
    assert np.abs(bend).max() < 1e-6
    assert np.abs(rest).max() < 1e-6


def test_mirrored_grid_is_turned_over() -> None:
    _, grid = board(5, 4)
    np.testing.assert_array_equal(right_handed(grid), grid)
    np.testing.assert_array_equal(right_handed(grid[:, ::-1]), grid)
    half_turn = grid[::-1, ::-1]
    np.testing.assert_array_equal(right_handed(half_turn), half_turn)


@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (4, 5), (6, 4), (7, 5), (4, 4), (5, 5)])
@pytest.mark.parametrize("turns", range(4))
def test_orientation_undoes_every_turn_it_can(columns: int, rows: int, turns: int) -> None:
    image, grid = board(columns, rows)
    given = np.rot90(grid, turns)
    if turns % 2 == 1 and rows != columns:
        given = np.rot90(given)  # a detector asked for columns x rows hands over only half turns
    oriented, warnings = orient(given, measure_colours(image, given).origin_is_black)
    np.testing.assert_array_equal(oriented, grid)  # upright and black at the origin is right by every rule
    assert [w.code for w in warnings] == ([] if (columns + rows) % 2 else ["orientation_ambiguous"])


def test_direction_decides_only_where_colour_cannot() -> None:
    _, odd = board(5, 4)
    oriented, _ = orient(odd, origin_is_black=False)
    np.testing.assert_array_equal(oriented, odd[::-1, ::-1])
    _, even = board(6, 4)
    oriented, _ = orient(even, origin_is_black=False)  # printed the other way round: white at both ends
    np.testing.assert_array_equal(oriented, even)


def test_colours() -> None:
    image, grid = board(6, 5)
    colours = measure_colours(image, grid)
    assert colours.origin_is_black
    assert colours.contrast == pytest.approx(180.0)
    assert colours.right == 1.0
    assert not measure_colours(image, grid[:, 1:]).origin_is_black
    flat = measure_colours(np.full_like(image, 90.0), grid)
    assert not flat.are_a_chessboard
    stripes = np.repeat(np.arange(image.shape[1]) // PITCH % 2 * 150.0, 1)[None, :] * np.ones(
        (image.shape[0], 1)
    )
    assert not measure_colours(stripes.astype(np.float32), grid).are_a_chessboard


def test_lattice_ends_where_the_board_does() -> None:
    image, grid = board(8, 6)
    whole = lines_beyond(image, grid, measure_colours(image, grid))
    assert [line.is_lattice for line in whole] == [False] * 4
    assert all(line.is_visible for line in whole)
    for part, sides in (
        (grid[1:], [True, False, False, False]),
        (grid[:-1], [False, True, False, False]),
        (grid[:, 2:], [False, False, True, False]),
        (grid[:, :-3], [False, False, False, True]),
        (grid[1:-1, 1:-1], [True] * 4),
    ):
        found = lines_beyond(image, part, measure_colours(image, part))
        assert [line.is_lattice for line in found] == sides


def test_the_boards_outline_is_no_line_of_corners() -> None:
    image, grid = board(8, 6)
    assert outer_lines_are_corners(image, grid, measure_colours(image, grid))
    assert outer_lines_are_corners(image, grid[1:4, 2:], measure_colours(image, grid[1:4, 2:]))
    _, larger = board(9, 7)
    for wrong in (larger[:, :8], larger[:6], larger - PITCH):
        assert not outer_lines_are_corners(image, wrong, measure_colours(image, wrong))


def test_growing_finds_the_whole_board_and_stops() -> None:
    image, grid = board(8, 6)
    for part in (grid[2:5, 1:5], grid[:3, :3], grid[3:, 5:], grid):
        np.testing.assert_allclose(grow(image, part), grid, atol=0.05)


def test_refinement_pulls_a_rough_grid_onto_the_corners() -> None:
    image, grid = board(6, 5)
    rough = grid + np.random.default_rng(1).uniform(-1.5, 1.5, grid.shape)
    np.testing.assert_allclose(refine(image, rough), grid, atol=0.02)


def test_noise_level_is_found_between_the_edges() -> None:
    image, grid = board(8, 6)
    noisy = image + np.random.default_rng(2).normal(0.0, 3.0, image.shape).astype(np.float32)
    assert noise_level(noisy, grid) == pytest.approx(3.0, rel=0.15)  # edges raise the median a little
    assert noise_level(image, grid) == pytest.approx(12**-0.5)
