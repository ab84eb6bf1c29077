"""Marks of an overlay: grid points, residual arrows, candidates and axes, sized by the width of the drawing.

Each mark has a dark rim, so that it is seen on white squares and on black ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from app.reports.overlay.content import Axis, Points
from app.reports.overlay.lettering import Colour, Type, text_width, write

RIM: Colour = (24, 24, 24)
USED: Colour = (120, 235, 60)
REJECTED: Colour = (220, 60, 255)
UNJUDGED: Colour = (40, 215, 255)
CANDIDATE: Colour = (40, 165, 255)
RESIDUAL: Colour = (0, 240, 255)
AXES: dict[str, Colour] = {"x": (40, 40, 240), "y": (40, 200, 40), "z": (255, 110, 40)}
_SUBPIXEL = 4  # bits of fraction in OpenCV's coordinates
_MEDIAN_ARROW = 1 / 32  # of the width: the length of the median residual's arrow
_LONGEST_ARROW = 1 / 8
_MAX_SAMPLED = 200


@dataclass(frozen=True, slots=True)
class MarkSizes:
    """Radius of a point's ring and thickness of lines, px."""

    radius: float
    line: int

    @classmethod
    def for_width(cls, width_px: int, spacing_px: float = math.inf) -> MarkSizes:
        """Return sizes for a drawing of this width whose nearest points are `spacing_px` apart."""
        return cls(
            max(2.0, width_px / 320, min(width_px / 130, 0.3 * spacing_px)), max(1, round(width_px / 700))
        )


def spacing(places: Float[np.ndarray, "n 2"]) -> float:
    """Return the median distance of a point from its nearest neighbour; infinity for fewer than two."""
    if len(places) < 2:
        return math.inf
    sample = places[:: max(1, len(places) // _MAX_SAMPLED)]
    nearest = []
    for place in sample:
        squares = np.sum((places - place) ** 2, axis=1)
        nearest.append(float(np.partition(squares, 1)[1]))
    return math.sqrt(float(np.median(nearest)))


def residual_scale(residuals_px: Float[np.ndarray, "n 2"], width_px: int, per_px: float) -> float | None:
    """Return by how much residuals are enlarged, 1, 2 or 5 times a power of ten: the median one is then visible.

    `per_px` is how many pixels of the drawing one of the image takes. None without a residual.
    """
    lengths = np.linalg.norm(residuals_px, axis=1)
    known = lengths[np.isfinite(lengths)]
    median = float(np.median(known)) if len(known) else 0.0
    if median <= 0.0:
        return None
    wanted = _MEDIAN_ARROW * width_px / (median * per_px)
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted * (1.0 + 1e-9))


def draw_points(
    canvas: UInt8[np.ndarray, "h w 3"], points: Points, places: Float[np.ndarray, "n 2"], sizes: MarkSizes
) -> None:
    """Draw every grid point by what the fit made of it; `places` are those of the drawing."""
    for place, used, judged in zip(places, points.used.tolist(), points.judged.tolist(), strict=True):
        if not judged:
            draw_ring(canvas, place, sizes, UNJUDGED)
        elif used:
            draw_ring(canvas, place, sizes, USED)
        else:
            draw_cross(canvas, place, sizes, REJECTED)


def draw_residuals(
    canvas: UInt8[np.ndarray, "h w 3"],
    starts: Float[np.ndarray, "n 2"],
    steps: Float[np.ndarray, "n 2"],
    sizes: MarkSizes,
) -> int:
    """Draw an arrow along each step; return how many were longer than fits and are cut."""
    longest, cut = _LONGEST_ARROW * canvas.shape[1], 0
    for start, step in zip(starts, steps, strict=True):
        length = float(np.hypot(*step))
        if not math.isfinite(length) or length < 0.5:
            continue
        if length > longest:
            step, cut = step * (longest / length), cut + 1
        draw_arrow(canvas, start, start + step, sizes, RESIDUAL)
    return cut


def draw_axes(
    canvas: UInt8[np.ndarray, "h w 3"],
    axes: tuple[Axis, ...],
    places: Float[np.ndarray, "a 2 2"],
    sizes: MarkSizes,
    kind: Type,
) -> None:
    """Draw the target's axes with their letters; `places` are start and end of each in the drawing."""
    thick = MarkSizes(sizes.radius, max(2, 2 * sizes.line))
    for axis, (start, end) in zip(axes, places, strict=True):
        draw_arrow(canvas, start, end, thick, AXES[axis.name])
    for axis, (start, end) in zip(axes, places, strict=True):
        beyond = end + (end - start) / max(float(np.hypot(*(end - start))), 1.0) * 0.8 * kind.size_px
        left = round(float(beyond[0])) - text_width(axis.name, kind) // 2
        baseline = round(float(beyond[1])) + kind.size_px // 3
        for right, down in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            write(canvas, axis.name, left + right, baseline + down, kind, RIM)
        write(canvas, axis.name, left, baseline, kind, AXES[axis.name])


def draw_ring(
    canvas: UInt8[np.ndarray, "h w 3"], place: Float[np.ndarray, "2"], sizes: MarkSizes, colour: Colour
) -> None:
    """Draw a circle about a place, which it leaves free."""
    for line, shade in ((sizes.line + 2, RIM), (sizes.line, colour)):
        cv2.circle(
            canvas, _fixed(place), round(sizes.radius * (1 << _SUBPIXEL)), shade, line, cv2.LINE_AA, _SUBPIXEL
        )


def draw_cross(
    canvas: UInt8[np.ndarray, "h w 3"],
    place: Float[np.ndarray, "2"],
    sizes: MarkSizes,
    colour: Colour,
    *,
    is_upright: bool = False,
) -> None:
    """Draw two strokes through a place: × or, upright, +."""
    reach = sizes.radius * (1.0 if is_upright else 0.9)
    strokes = ((1.0, 0.0), (0.0, 1.0)) if is_upright else ((1.0, 1.0), (1.0, -1.0))
    for line, shade in ((sizes.line + 2, RIM), (sizes.line, colour)):
        for stroke in strokes:
            half = reach * np.array(stroke)
            _line(canvas, place - half, place + half, shade, line)


def draw_arrow(
    canvas: UInt8[np.ndarray, "h w 3"],
    start: Float[np.ndarray, "2"],
    end: Float[np.ndarray, "2"],
    sizes: MarkSizes,
    colour: Colour,
) -> None:
    """Draw an arrow whose head is no longer than a third of it."""
    way = end - start
    length = float(np.hypot(*way))
    head = min(0.35 * length, 4.5 * sizes.line + 2.0)
    along = way / max(length, 1e-9)
    across = np.array([-along[1], along[0]])
    wings = [end - head * along + side * 0.5 * head * across for side in (1.0, -1.0)]
    for line, shade in ((sizes.line + 2, RIM), (sizes.line, colour)):
        for begin in (start, *wings):
            _line(canvas, begin, end, shade, line)


def _line(
    canvas: UInt8[np.ndarray, "h w 3"],
    start: Float[np.ndarray, "2"],
    end: Float[np.ndarray, "2"],
    colour: Colour,
    line: int,
) -> None:
    cv2.line(canvas, _fixed(start), _fixed(end), colour, line, cv2.LINE_AA, _SUBPIXEL)


def _fixed(place: Float[np.ndarray, "2"]) -> tuple[int, int]:
    """Return a place in OpenCV's fixed point; what lies far outside is brought to where numbers still fit."""
    u, v = np.clip(place, -30_000.0, 30_000.0).tolist()
    return round(u * (1 << _SUBPIXEL)), round(v * (1 << _SUBPIXEL))
