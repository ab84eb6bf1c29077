"""Outlines of the printed pattern of a target, in the target frame, mm.

An outline is a closed path of lines (L) and cubic curves (C), with black on its right as seen with y down: holes run
the other way round, and all outlines of a sheet can be filled together by the non-zero rule. Squares that share an edge
share one outline, so that no seam is visible, however it is rasterised.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core import TargetSpec
from core.targets import DotPattern, RectilinearPattern, mark_diameter_mm, marked_squares, pattern_of

Step = tuple[str, tuple[float, ...]]
Path = tuple[Step, ...]
"""Steps M (x, y), L (x, y), C (x1, y1, x2, y2, x, y) and Z (), as PDF and SVG both have them."""

_ARCS = 8
_ARM = 4.0 / 3.0 * math.tan(math.pi / (2 * _ARCS))  # of the radius; off the circle by 4e-6 of it


@dataclass(frozen=True, slots=True)
class Outlines:
    """Outlines, and their bounding box (minimum and maximum of x and y)."""

    paths: tuple[Path, ...]
    low: tuple[float, float]
    high: tuple[float, float]


def pattern_outlines(target: TargetSpec, *, origin_dot: float = 1.0, marks: bool = False) -> Outlines:
    """Return the outlines of a target: of a dot grid with an origin dot `origin_dot` times as wide as the others, of a
    chessboard with its fiducial dots (`marks`).

    Raises InvalidTarget for targets that cannot be printed.
    """
    pattern = pattern_of(target, 0.0, origin_dot)
    if isinstance(pattern, DotPattern):
        return _dots(pattern)
    outlines = _rectilinear(pattern)
    if not marks:
        return outlines
    radius = 0.5 * mark_diameter_mm(target)
    dots = [
        circle((i + 0.5) * target.pitch_mm, (j + 0.5) * target.pitch_mm, radius, hole=(i + j) % 2 == 0)
        for i, j in marked_squares(target)
    ]
    return Outlines((*outlines.paths, *dots), outlines.low, outlines.high)


def circle(x: float, y: float, radius: float, *, hole: bool = False) -> Path:
    """Return a circle in eight curves."""
    sign = -1.0 if hole else 1.0
    turn = sign * 2.0 * math.pi / _ARCS
    steps: list[Step] = [("M", (x + radius, y))]
    for k in range(_ARCS):
        (c0, s0), (c1, s1) = ((math.cos(a), math.sin(a)) for a in (k * turn, (k + 1) * turn))
        arm = sign * _ARM
        corners = ((c0 - arm * s0, s0 + arm * c0), (c1 + arm * s1, s1 - arm * c1), (c1, s1))
        steps.append(("C", tuple(v for a, b in corners for v in (x + radius * a, y + radius * b))))
    return (*steps, ("Z", ()))


def box(left: float, top: float, right: float, bottom: float) -> Path:
    """Return a filled rectangle."""
    corners = ((right, top), (right, bottom), (left, bottom))
    return (("M", (left, top)), *(("L", corner) for corner in corners), ("Z", ()))


def translated(path: Path, dx: float, dy: float) -> Path:
    """Return the outline moved by (dx, dy)."""
    return tuple((op, tuple(v + (dx, dy)[k % 2] for k, v in enumerate(values))) for op, values in path)


def _dots(pattern: DotPattern) -> Outlines:
    q, p = np.nonzero(pattern.radius_mm)
    radius = pattern.radius_mm[q, p]
    index = np.stack([p + pattern.first[0], q + pattern.first[1]], axis=1)
    centres = index @ np.linalg.inv(pattern.to_index).T
    low, high = (centres - radius[:, None]).min(axis=0), (centres + radius[:, None]).max(axis=0)
    paths = tuple(circle(x, y, r) for (x, y), r in zip(centres.tolist(), radius.tolist(), strict=True))
    return Outlines(paths, (float(low[0]), float(low[1])), (float(high[0]), float(high[1])))


def _rectilinear(pattern: RectilinearPattern) -> Outlines:
    black = (pattern.white < 0.5) & (pattern.sheet > 0.5)
    x, y = pattern.x_edges, pattern.y_edges
    columns, rows = np.flatnonzero(black.any(axis=0)), np.flatnonzero(black.any(axis=1))
    return Outlines(
        tuple(_loops(black, x, y)),
        (float(x[columns[0] - 1]), float(y[rows[0] - 1])),
        (float(x[columns[-1]]), float(y[rows[-1]])),
    )


def _loops(
    black: Bool[np.ndarray, "ny+1 nx+1"], x: Float[np.ndarray, " nx"], y: Float[np.ndarray, " ny"]
) -> Iterator[Path]:
    """Yield the outlines of the black cells; cell (j, i) lies between the edges j - 1 and j, i - 1 and i.

    Along an edge of a cell the outline runs clockwise as seen: rightward on top, down on the right. Where two cells
    touch in a corner only, it turns with its own cell.
    """
    top, bottom = black[1:] & ~black[:-1], black[:-1] & ~black[1:]
    left, right = black[:, 1:] & ~black[:, :-1], black[:, :-1] & ~black[:, 1:]
    # Edges (j, i, direction) from corner (j, i) rightward, down, leftward, up.
    edges = [(j, i - 1, 0) for j, i in np.argwhere(top).tolist()]
    edges += [(j - 1, i, 1) for j, i in np.argwhere(right).tolist()]
    edges += [(j, i, 2) for j, i in np.argwhere(bottom).tolist()]
    edges += [(j, i, 3) for j, i in np.argwhere(left).tolist()]
    open_edges = set(edges)
    steps = ((0, 1), (1, 0), (0, -1), (-1, 0))
    for first in edges:
        if first not in open_edges:
            continue
        j, i, direction = first
        corners = []
        while True:
            open_edges.remove((j, i, direction))
            j, i = j + steps[direction][0], i + steps[direction][1]
            # With one's own cell on the right: turn right, go on, or turn left.
            nexts = ((t, (j, i, (direction + t) % 4)) for t in (1, 0, 3))
            turned = next(t for t, edge in nexts if edge in open_edges or edge == first)
            direction = (direction + turned) % 4
            if turned:
                corners.append((float(x[i]), float(y[j])))
            if (j, i, direction) == first:
                break
        yield (("M", corners[0]), *(("L", corner) for corner in corners[1:]), ("Z", ()))
