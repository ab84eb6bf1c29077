"""Boards of dots for mutated views (`mutated_views`): of random size, soiled, and what distinguishes them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, Int

from core.calibration.multi_view.board_symmetry import quarter_turns, turned_cells
from core.targets.grid_index import is_staggered
from core.targets.printed_pattern import DotPattern
from core.targets.specification import GridPoints, TargetSpec

KINDS = ("circles", "asymmetric_circles")
_PITCH_MM = 30.0
_MARKED = 0.4  # of the boards have a larger dot at the origin


def draw_dots(rng: np.random.Generator, kind: str) -> TargetSpec:
    """Return a board of random size and dots."""
    columns, rows = int(rng.integers(3, 15)), int(rng.integers(3, 11))
    if kind == "asymmetric_circles":
        columns, rows = int(rng.integers(3, 8)), int(rng.integers(4, 16))
    apart = _PITCH_MM * (2.0**0.5 if kind == "asymmetric_circles" else 1.0)
    return TargetSpec(kind, columns, rows, _PITCH_MM, apart * float(rng.uniform(0.3, 0.7)))


def draw_origin_dot(rng: np.random.Generator, target: TargetSpec) -> float:
    """Return how much wider the dot at the origin is: of staggered boards, which need no such dot, not at all."""
    wider, is_marked = float(rng.uniform(1.35, 2.2)), bool(rng.random() < _MARKED)
    room = (
        1.7 * target.pitch_mm / (target.marker_mm or target.pitch_mm) - 1.0
    )  # so that blur joins it to no other
    return min(wider, room) if is_marked and not is_staggered(target) and room > 1.35 else 1.0


def differs_in_a_mirror(target: TargetSpec, origin_dot: float) -> bool:
    """Return whether a mirrored print is another board than the right one."""
    if is_staggered(target):
        return target.rows % 2 == 0 and target.rows != 2 * target.columns
    return origin_dot > 1.0 and target.columns != target.rows


def may_show(one: TargetSpec, other: TargetSpec) -> bool:
    """Return whether the dots of one board, or those of them that are in view, may be all of another's."""
    if (one.kind, is_staggered(one)) == (other.kind, True):
        return one.columns >= other.columns and one.rows >= other.rows
    sizes = [sorted((target.columns, target.rows)) for target in (one, other)]
    return one.kind == other.kind and all(a >= b for a, b in zip(*sizes, strict=True))


def readings(found: GridPoints) -> list[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]]:
    """Return the columns and rows of grid points; of a board that looks the same when turned, in every turn."""
    if found.labelling == "up_to_symmetry":
        return [turned_cells(found.target, found.column, found.row, n) for n in quarter_turns(found.target)]
    return [(found.column, found.row)]


def soiled_dots(rng: np.random.Generator, sheet: DotPattern, changes: list[str]) -> DotPattern:
    """Return the sheet with some of its dots worn, or worn away; the widest, which may identify the origin, is not."""
    if rng.random() >= 0.4:
        return sheet
    radius = sheet.radius_mm.copy()
    wrong = rng.random(radius.shape) < 10.0 ** rng.uniform(-2.5, -0.7)
    wrong &= (radius < radius.max()) | (radius == np.median(radius[radius > 0.0]))
    radius[wrong] *= rng.choice([0.0, 0.6, 0.8], int(wrong.sum()))
    changes.append("worn_dots")
    return replace(sheet, radius_mm=radius)


def add_blots(
    rng: np.random.Generator,
    levels: Float[np.ndarray, "h w"],
    points: Float[np.ndarray, "n 2"],
    changes: list[str],
) -> None:
    """Put blots as large as dots on and around the board."""
    if rng.random() >= 0.3:
        return
    low, high = points.min(axis=0), points.max(axis=0)
    radius = 0.3 * np.sqrt(float(np.prod(high - low)) / len(points))
    for _ in range(int(rng.integers(1, 12))):
        u, v = rng.uniform(low - 4.0 * radius, high + 4.0 * radius)
        axes = tuple(round(16.0 * float(r)) for r in radius * rng.uniform(0.5, 1.3, 2))
        grey = float(rng.uniform(5.0, 90.0))
        cv2.ellipse(
            levels,
            (round(16.0 * u), round(16.0 * v)),
            axes,
            float(rng.uniform(0.0, 180.0)),
            0.0,
            360.0,
            grey,
            cv2.FILLED,
            cv2.LINE_AA,
            4,
        )
    changes.append("blots")
