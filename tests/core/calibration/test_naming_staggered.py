"""Parts of boards of staggered dots named by a picture of the whole: shifts and turns that keep the stagger."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.calibration.naming_parts import Named, name_points
from core.camera import Camera, project
from core.targets.dot_sites import cells_of, sites_of
from core.targets.specification import GridPoints, TargetSpec
from core.transforms import so3_exp, transform, transform_points

CAMERA = Camera(1500.0, 1500.0, 640.0, 480.0, -0.1, 0.02)
BOARDS = [TargetSpec("asymmetric_circles", *size, 10.0) for size in ((6, 11), (6, 12), (5, 14))]


def picture(target: TargetSpec, seed: int, aside_mm: tuple[float, float] = (0.0, 0.0)) -> GridPoints:
    """What is in view of a board that a robot's pose shows, again and again nearly the same."""
    rng = np.random.default_rng(seed)
    R = so3_exp(np.array([0.4, 0.2, 0.7]))
    middle = np.array([0.0, 0.0, 190.0]) + rng.normal(0.0, 0.05, 3)
    T = transform(R, middle - R @ (target.points_target().mean(axis=0) + np.array([*aside_mm, 0.0])))
    px = project(transform_points(T, target.points_target()), CAMERA) + rng.normal(
        0.0, 0.05, (target.size, 2)
    )
    row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
    return GridPoints(target, 1280, 960, column, row, px, np.full(target.size, 0.05))


def of_points(points: GridPoints, keep: np.ndarray) -> GridPoints:
    return replace(
        points,
        column=points.column[keep],
        row=points.row[keep],
        points_px=points.points_px[keep],
        standard_uncertainty_px=points.standard_uncertainty_px[keep],
    )


def counted_anew(points: GridPoints, quarters: int) -> GridPoints:
    """The points by columns and rows that count from their own corner, turned by quarter turns."""
    sites = sites_of(points.target, points.column, points.row)
    for _ in range(quarters):
        sites = np.stack([-sites[:, 1], sites[:, 0]], axis=1)
    sites = sites - sites.min(axis=0)
    if sites[0].sum() % 2:
        sites = sites + np.array([1, 0])
    column, row = cells_of(points.target, sites)
    return replace(points, column=column, row=row, origin="unknown")


@pytest.mark.parametrize("target", BOARDS, ids=lambda target: f"{target.columns}x{target.rows}")
@pytest.mark.parametrize("quarters", range(4))
def test_a_part_of_staggered_dots_is_named_by_a_picture_of_the_whole(
    target: TargetSpec, quarters: int
) -> None:
    """By that of a pose where all is in view, were the picture larger; parts that begin on even and on odd lines."""
    reference, again = picture(target, 1), picture(target, 2)
    x, y = sites_of(target, again.column, again.row).T
    sizes = []
    for left, top in ((0, 0), (1, 0), (0, 1), (3, 2), (2, 3)):
        seen = of_points(again, (x >= left) & (x < left + 7) & (y >= top) & (y < top + 8))
        low, high = seen.points_px.min(axis=0) - 3.0, seen.points_px.max(axis=0) + 3.0
        width, height = (high - low).astype(int).tolist()
        cropped = replace(seen, points_px=seen.points_px - low, image_width_px=width, image_height_px=height)
        beyond = replace(reference, points_px=reference.points_px - low)
        part = counted_anew(cropped, quarters)
        named = name_points(part, beyond)
        sizes.append(isinstance(named, Named))
        if isinstance(named, Named):
            np.testing.assert_array_equal(named.column, seen.column)
            np.testing.assert_array_equal(named.row, seen.row)
    assert all(sizes)


@pytest.mark.parametrize("lines", [(1, 1), (2, 0), (0, 2), (-3, 1)])
def test_a_part_whose_board_stood_lines_aside_is_none_of_it(lines: tuple[int, int]) -> None:
    """It shows the same pattern at the same pixels, but that an end of it lies where the others have another line."""
    target = BOARDS[0]
    moved = picture(target, 2, (lines[0] * target.pitch_mm, lines[1] * target.pitch_mm))
    x, y = sites_of(target, moved.column, moved.row).T
    shown = (x >= 1 - lines[0]) & (x <= 10 - lines[0]) & (y >= 1 - lines[1]) & (y <= 9 - lines[1])
    part = counted_anew(of_points(moved, shown), 0)
    assert not isinstance(name_points(part, picture(target, 1)), Named)
