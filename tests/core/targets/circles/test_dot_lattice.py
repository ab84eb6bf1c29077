"""The lattice of a board of dots: where its places lie, and what its crosses are of."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.errors import OriginUnknown, TargetMismatch, TargetNotFound
from core.targets import TargetSpec, detect
from core.targets.circles.blobs import Dots
from core.targets.circles.lattice import crosses, dot_lattices
from core.targets.grid_index import cells_of, lines
from tests.support.image.dot_sites import sites_of
from tests.support.targets.dot_scenes import ASYMMETRIC, SYMMETRIC


def test_staggered_places_are_where_the_dots_lie() -> None:
    for target in (SYMMETRIC, ASYMMETRIC, replace(ASYMMETRIC, rows=10)):
        row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
        sites = sites_of(target, column, row)
        np.testing.assert_allclose(sites * target.pitch_mm, target.points_target()[:, :2])
        assert tuple(sites.max(axis=0) + 1) == lines(target)
        np.testing.assert_array_equal(np.stack(cells_of(target, sites)), np.stack([column, row]))


def test_crosses_are_those_of_a_print_seen_aslant() -> None:
    """Any linear map of a square lattice of circles: its own steps, but for a quarter turn, and no irregularity."""
    A = np.array([[21.0, 6.0], [-4.0, 13.0]])
    q, p = np.mgrid[0:6, 0:7]
    centres = np.stack([p.ravel(), q.ravel()], axis=1) @ A.T + 100.0
    dots = Dots(centres, np.tile(0.25**2 * A @ A.T / 4.0, (42, 1, 1)), np.ones(42), are_dark=True)
    near = np.argsort(np.linalg.norm(centres[:, None] - centres[None], axis=2), axis=1, kind="stable")[
        :, 1:25
    ]
    steps, irregular = crosses(dots.centres, dots.moments, near)
    inner = np.flatnonzero(((p > 0) & (p < 6) & (q > 0) & (q < 5)).ravel())
    np.testing.assert_allclose(irregular[inner], 0.0, atol=1e-9)
    assert np.isinf(irregular[0])
    for step in steps[inner]:
        turn = np.linalg.solve(A, step.T)
        np.testing.assert_allclose(turn, np.rint(turn), atol=1e-9)
        assert np.linalg.det(turn) == pytest.approx(1.0)
    (lattice,) = dot_lattices(dots)
    assert sorted(lattice.dots.tolist()) == list(range(42))
    terms = np.column_stack([lattice.places, np.ones(42)])
    turn = np.linalg.solve(A, np.linalg.lstsq(terms, centres[lattice.dots], rcond=None)[0][:2].T)
    np.testing.assert_allclose(turn, np.rint(turn), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_squares_are_no_part_of_a_board_of_dots() -> None:
    """A grille that runs out of the image: a lattice, but not of dots."""
    image = np.full((500, 700), 190, np.uint8)
    for v in range(40, 500, 40):
        for u in range(200, 740, 40):
            image[v - 10 : v + 10, u - 10 : u + 10] = 40
    with pytest.raises((TargetNotFound, TargetMismatch)):
        detect(cv2.GaussianBlur(image, (0, 0), 1.0), TargetSpec("circles", 20, 15, 20.0))
    for v in range(40, 500, 40):
        for u in range(200, 740, 40):
            image[v - 15 : v + 15, u - 15 : u + 15] = 190
            cv2.circle(image, (u, v), 11, 40, -1, cv2.LINE_AA)
    with pytest.raises(OriginUnknown):
        detect(cv2.GaussianBlur(image, (0, 0), 1.0), TargetSpec("circles", 20, 15, 20.0))
