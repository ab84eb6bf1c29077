"""The standard's test poses: where they lie in the cube."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.metrology import TEST_PLANES, VISITS, TestCube


@pytest.mark.parametrize("plane", TEST_PLANES)
def test_five_poses_lie_in_one_diagonal_plane_on_its_diagonals(plane: str) -> None:
    cube = TestCube((900.0, -100.0, 450.0), 300.0, plane)
    points = cube.positions_mm
    centred = points - points[0]
    assert points[0].tolist() == [900.0, -100.0, 450.0]
    assert np.linalg.matrix_rank(centred, tol=1e-9) == 2
    diagonal = 300.0 * math.sqrt(3.0)
    assert np.linalg.norm(centred[1:], axis=1) == pytest.approx(0.4 * diagonal)  # .5 less a tenth
    # P2 and P4, and P3 and P5, face one another over P1; the plane is a rectangle of 1 by the root of 2.
    assert centred[1] == pytest.approx(-centred[3])
    assert centred[2] == pytest.approx(-centred[4])
    sides = np.linalg.norm(np.diff(points[1:], axis=0), axis=1)
    assert sorted(sides[:2]) == pytest.approx([240.0, 240.0 * math.sqrt(2.0)])
    assert VISITS[-1] == "P1"
    assert len(set(VISITS)) == 5


def test_the_corners_are_those_of_a_cube_along_the_axes() -> None:
    corners = TestCube((0.0, 0.0, 0.0), 2.0).corners_mm
    assert np.array_equal(np.abs(corners), np.ones((8, 3)))
    assert corners[0].tolist() == [1.0, 1.0, 1.0]
    assert np.array_equal(corners[4:], corners[:4] * [1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("centre", "side", "plane"),
    [
        ((0.0, 0.0, 0.0), 0.0, "C1-C2-C7-C8"),
        ((0.0, math.nan, 0.0), 100.0, "C1-C2-C7-C8"),
        ((0.0, 0.0, 0.0), 100.0, "C1-C2-C3-C4"),
    ],
)
def test_a_cube_that_cannot_be_is_refused(
    centre: tuple[float, float, float], side: float, plane: str
) -> None:
    with pytest.raises(InvalidArgument):
        TestCube(centre, side, plane)
