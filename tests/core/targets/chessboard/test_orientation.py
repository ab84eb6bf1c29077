"""Which corner of a chessboard is the origin: by its colour, and by direction only where colour cannot."""

from __future__ import annotations

import numpy as np
import pytest

from core.targets.chessboard.orientation import orient
from tests.support.targets.drawn_boards import board, lattice_of


@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (4, 5), (6, 4), (7, 5), (4, 4), (5, 5)])
@pytest.mark.parametrize("turns", range(4))
def test_orientation_undoes_every_turn_it_can(columns: int, rows: int, turns: int) -> None:
    _, grid = board(columns, rows)
    upright = lattice_of(grid, origin_is_bright=False)
    given = upright
    for _ in range(turns):
        given = given.quarter_turn()
    if turns % 2 == 1 and rows != columns:
        given = given.quarter_turn()  # lattices handed over have the target's rows and columns
    oriented, warnings = orient(given)
    np.testing.assert_array_equal(
        oriented.grid, grid
    )  # upright and black at the origin is right by every rule
    assert not oriented.origin_is_bright
    assert [w.code for w in warnings] == ([] if (columns + rows) % 2 else ["board_symmetry_unresolved"])


def test_a_quarter_turn_knows_the_colour_of_its_origin() -> None:
    image, grid = board(5, 4)
    lattice = lattice_of(grid, origin_is_bright=False)
    for _ in range(4):
        lattice = lattice.quarter_turn()
        u, v = np.rint(lattice.grid[:2, :2].mean(axis=(0, 1))).astype(int)
        assert lattice.origin_is_bright == bool(image[v, u] > 100)
    for top, left in ((0, 1), (1, 1), (2, 1)):
        part = lattice.cut(top, 4, left, 5)
        u, v = np.rint(part.grid[:2, :2].mean(axis=(0, 1))).astype(int)
        assert part.origin_is_bright == bool(image[v, u] > 100)


def test_direction_decides_only_where_colour_cannot() -> None:
    _, odd = board(5, 4)
    oriented, _ = orient(lattice_of(odd, origin_is_bright=True))
    np.testing.assert_array_equal(oriented.grid, odd[::-1, ::-1])
    _, even = board(6, 4)
    oriented, _ = orient(
        lattice_of(even, origin_is_bright=True)
    )  # printed the other way round: white at both ends
    np.testing.assert_array_equal(oriented.grid, even)
