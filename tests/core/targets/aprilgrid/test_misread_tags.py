"""Tags of an AprilGrid that are misread, foreign or torn apart, and how many it takes for another grid."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from core.errors import TargetMismatch
from core.targets import detect
from core.targets.aprilgrid.assembly import assemble
from core.targets.aprilgrid.layout import DICTIONARY, aprilgrid_layout
from core.targets.aprilgrid.tag_lattice import read_lattice
from core.targets.markers.dictionary import marker_bits
from core.targets.printed_pattern import RectilinearPattern, pattern_of
from core.targets.specification import TargetSpec

GRID = TargetSpec("aprilgrid", 5, 4, 32.5, 25.0)


def lattice(target: TargetSpec, step: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The sheet seen straight on, `step` px a mm, and all of its corners as a lattice."""
    pattern = pattern_of(target, 0.5)
    assert isinstance(pattern, RectilinearPattern)
    x0, y0 = pattern.x_edges[0], pattern.y_edges[0]
    x = x0 + (np.arange(round((pattern.x_edges[-1] - x0) * step)) + 0.5) / step
    y = y0 + (np.arange(round((pattern.y_edges[-1] - y0) * step)) + 0.5) / step
    ink = pattern.white[np.ix_(np.searchsorted(pattern.y_edges, y), np.searchsorted(pattern.x_edges, x))]
    j, i = (a.ravel() for a in np.mgrid[0 : target.grid_rows, 0 : target.grid_columns])
    points = (target.points_target()[:, :2] - [x0, y0]) * step - 0.5
    # the square between the lattice's (0, 0) and (1, 1) is bright: the grid's (0, 0), at a tag, is (1, 0)
    return (200 * ink + 20).astype(np.uint8), np.stack([i + 1, j], axis=1), points


def test_some_wrong_bits_are_put_right_and_more_are_no_tag() -> None:
    image, place, points = lattice(GRID, 4)
    layout = aprilgrid_layout(GRID)
    part = read_lattice(image, layout, place, points)
    assert part is not None
    assert sorted(part.tags) == list(range(20))
    for wrong, read in ((3, True), (4, False)):
        spoiled = image.copy()
        corner = part.tags[7][0]
        for k in range(wrong):
            u, v = np.rint(corner + (2.0 + k, 2.0 + k) * np.array([10.0, 10.0])).astype(int)
            spoiled[v : v + 10, u : u + 10] = 240 - spoiled[v + 5, u + 5]
        again = read_lattice(spoiled, layout, place, points)
        assert again is not None
        assert (7 in again.tags) == read
        assert again.conflicting == 0


def test_one_foreign_tag_is_no_tag_of_the_grid_but_many_are_another_grid() -> None:
    image, place, points = lattice(GRID, 4)
    layout = aprilgrid_layout(GRID)
    part = read_lattice(image, layout, place, points)
    assert part is not None
    spoiled = image.copy()
    for count, tag in enumerate((7, 12, 3), start=1):
        u, v = np.rint(part.tags[tag][0] + 20.5).astype(int)
        spoiled[v : v + 60, u : u + 60] = 20 + 200 * np.kron(
            marker_bits(DICTIONARY)[100 + tag], np.ones((10, 10))
        )
        again = read_lattice(spoiled, layout, place, points)
        assert again is not None
        assert again.conflicting == count
        assert tag not in again.tags
    with pytest.raises(TargetMismatch, match="3 of 20"):
        detect(cv2.GaussianBlur(spoiled, (0, 0), 1.0), GRID)


def test_a_tear_in_the_lattice_is_no_other_sheet() -> None:
    """A highlight may link the corners of two rows or columns wrongly; the tags beyond are where they belong."""
    image, place, points = lattice(GRID, 4)
    layout = aprilgrid_layout(GRID)
    whole = read_lattice(image, layout, place, points)
    assert whole is not None
    for axis, shift in ((0, 2), (0, 4), (1, 2)):
        torn = place.copy()
        torn[torn[:, axis] > 4, axis] += shift
        part = read_lattice(image, layout, torn, points)
        assert part is not None
        assert part.conflicting == len(part.displaced) >= 4
        found = assemble([part], image, layout)
        assert set(found.tags) == set(range(20))
        for tag, corners in found.tags.items():
            np.testing.assert_allclose(corners, whole.tags[tag], atol=1e-6)
    sheet = aprilgrid_layout(dataclasses.replace(GRID, columns=4, rows=5))
    other = read_lattice(image, sheet, place, points)
    assert other is not None
    with pytest.raises(TargetMismatch, match="a grid of 4 x 5 has them"):
        assemble([other], image, sheet)
