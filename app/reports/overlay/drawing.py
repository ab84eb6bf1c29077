"""The drawing of an overlay: the image at the width asked for, marks in it, and the panel below."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from app.reports.overlay import marks
from app.reports.overlay.content import OverlayContent, Points
from app.reports.overlay.lettering import Type
from app.reports.overlay.marks import MarkSizes
from app.reports.overlay.panel import PAPER, LegendEntry, draw_panel, text_size

_MAX_RATIO = 1.5  # height over width of the image's part of the drawing
_MIN_HEIGHT_PX = 24


def draw_overlay(content: OverlayContent, width_px: int) -> UInt8[np.ndarray, "h w 3"]:
    """Return the overlay at this width; a very high image is scaled to one and a half times it."""
    frame = _Frame.of(content, width_px)
    canvas = frame.canvas
    legend: list[LegendEntry] = []
    if content.points is not None:
        legend += _draw_points(frame, content.points)
    elif len(content.candidates_px):
        legend += _draw_candidates(frame, content.candidates_px)
    if content.axes:
        places = frame.place(np.array([[axis.start_px, axis.end_px] for axis in content.axes]))
        kind = Type.of(1.3 * text_size(width_px), is_bold=True)
        marks.draw_axes(canvas, content.axes, places, MarkSizes.for_width(width_px), kind)
        legend += [_axis_entry(axis.name, width_px) for axis in content.axes]
    return np.concatenate([canvas, draw_panel(width_px, content.statement, legend)])


class _Frame:
    """The canvas with the image on it, and where pixels of the original lie there."""

    def __init__(
        self, canvas: UInt8[np.ndarray, "h w 3"], scale: Float[np.ndarray, "2"], left_px: int
    ) -> None:
        self.canvas, self.scale, self._left_px = canvas, scale, left_px

    @classmethod
    def of(cls, content: OverlayContent, width_px: int) -> _Frame:
        columns, rows = content.image_width_px, content.image_height_px
        scale = min(width_px / columns, _MAX_RATIO * width_px / rows)
        size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
        enlarged = size[0] > content.grey.shape[1]
        interpolation = cv2.INTER_NEAREST if enlarged and scale > 3.0 else cv2.INTER_AREA
        if enlarged and scale <= 3.0:
            interpolation = cv2.INTER_CUBIC
        grey = cv2.resize(content.grey, size, interpolation=interpolation)
        left = (width_px - size[0]) // 2
        canvas = np.full((max(size[1], _MIN_HEIGHT_PX), width_px, 3), PAPER, dtype=np.uint8)
        canvas[: size[1], left : left + size[0]] = grey[..., None]
        return cls(canvas, np.array([size[0] / columns, size[1] / rows]), left)

    def place(self, places_px: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Return places of the original in the canvas; (0, 0) is the centre of the top-left pixel in both."""
        return np.asarray((places_px + 0.5) * self.scale - 0.5 + np.array([self._left_px, 0.0]))


def _draw_points(frame: _Frame, points: Points) -> list[LegendEntry]:
    """Draw points and residuals; return their legend."""
    places, width = frame.place(points.places_px), frame.canvas.shape[1]
    sizes = MarkSizes.for_width(width, marks.spacing(places))
    used, rejected = points.judged & points.used, points.judged & ~points.used
    marks.draw_points(frame.canvas, points, places, sizes)
    kept = points.residuals_px[used]
    scale = marks.residual_scale(kept, width, float(frame.scale[0]))
    cut = 0
    if scale is not None:
        steps = points.residuals_px * frame.scale * scale
        cut = marks.draw_residuals(frame.canvas, places, steps, sizes)
    swatch = MarkSizes.for_width(width)
    entries = []
    if used.any():
        entries.append(
            LegendEntry(
                partial(_ring, sizes=swatch, colour=marks.USED), f"grid points used: {int(used.sum())}"
            )
        )
    if used.any() or rejected.any():
        entries.append(
            LegendEntry(
                partial(_cross, sizes=swatch, colour=marks.REJECTED, is_upright=False),
                f"rejected: {int(rejected.sum())}",
            )
        )
    if not points.judged.all():
        found = f"grid points found, no camera fitted: {int((~points.judged).sum())}"
        entries.append(LegendEntry(partial(_ring, sizes=swatch, colour=marks.UNJUDGED), found))
    if scale is not None:
        text = f"residuals, {scale:g} times enlarged"
        if cut:
            text += f"; {cut} longer ones cut"
        entries.append(LegendEntry(partial(_arrow, sizes=swatch, colour=marks.RESIDUAL), text))
    return entries


def _draw_candidates(frame: _Frame, candidates_px: Float[np.ndarray, "m 2"]) -> list[LegendEntry]:
    places, width = frame.place(candidates_px), frame.canvas.shape[1]
    sizes = MarkSizes.for_width(width, marks.spacing(places))
    for place in places:
        marks.draw_cross(frame.canvas, place, sizes, marks.CANDIDATE, is_upright=True)
    swatch = partial(_cross, sizes=MarkSizes.for_width(width), colour=marks.CANDIDATE, is_upright=True)
    return [LegendEntry(swatch, f"candidates for grid points (no target found): {len(places)}")]


def _axis_entry(name: str, width_px: int) -> LegendEntry:
    sizes = MarkSizes(0.0, max(2, 2 * MarkSizes.for_width(width_px).line))
    meaning = {"x": "target's x", "y": "y", "z": "z, into the target"}[name]
    return LegendEntry(partial(_arrow, sizes=sizes, colour=marks.AXES[name]), meaning)


def _ring(
    panel: UInt8[np.ndarray, "h w 3"], at: Float[np.ndarray, "2"], *, sizes: MarkSizes, colour: marks.Colour
) -> None:
    marks.draw_ring(panel, at, sizes, colour)


def _cross(
    panel: UInt8[np.ndarray, "h w 3"],
    at: Float[np.ndarray, "2"],
    *,
    sizes: MarkSizes,
    colour: marks.Colour,
    is_upright: bool,
) -> None:
    marks.draw_cross(panel, at, sizes, colour, is_upright=is_upright)


def _arrow(
    panel: UInt8[np.ndarray, "h w 3"], at: Float[np.ndarray, "2"], *, sizes: MarkSizes, colour: marks.Colour
) -> None:
    half = np.array([0.6 * text_size(panel.shape[1]), 0.0])
    marks.draw_arrow(panel, at - half, at + half, sizes, colour)
