"""Where the camera is certain: projection uncertainty over the image, and how many points each part of it has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from app.reports.camera_plots.coverage_cells import ProjectionField
from app.reports.camera_plots.image_axes import draw_cells, frame_image
from app.reports.svg import FAINT, INK, axes_at, draw_svg, short, text_at

_LEFT, _PANEL_WIDTH, _GAP = 0.8, 4.2, 1.6
_HEADER, _CAPTION, _BELOW, _FOOTER = 0.62, 0.98, 0.62, 0.6
_BLANK: dict[str, Any] = {"facecolor": (1.0, 1.0, 1.0, 0.45), "edgecolor": INK, "hatch": "////", "lw": 0.0}
"""Cells without points: paler, and hatched, so that the colours below remain legible."""


def projection_svg(fields: Sequence[ProjectionField], title: str, about: str = "") -> bytes:
    """Return for every focus group the projection uncertainty and the points over the image."""
    return draw_svg(
        lambda: projection_figure(fields, title),
        title,
        "\n".join("   ·   ".join(_caption(field)) for field in fields),
        about,
    )


def projection_figure(fields: Sequence[ProjectionField], title: str) -> Figure:
    """Draw it; within `drawing_style`."""
    heights = [min(_PANEL_WIDTH * f.cells.height_px / f.cells.width_px, 9.0) for f in fields]
    rows = [_CAPTION + height + _BELOW for height in heights]
    figure = Figure((_LEFT + 2 * _PANEL_WIDTH + _GAP + 0.95, _HEADER + sum(rows) + _FOOTER))
    text_at(figure, 0.15, 0.32, title, fontsize=12, weight="bold")
    top = _HEADER
    for field, height, row in zip(fields, heights, rows, strict=True):
        for line, text in enumerate(_caption(field)):
            text_at(figure, 0.15, top + 0.12 + 0.21 * line, text, fontsize=8 if line else 9)
        covered = field.largest_covered_px
        panels = (
            (
                "standard uncertainty at infinity (figures: largest of a ninth)",
                field.uncertainty_px,
                covered,
                "px",
            ),
            (
                "grid points in a cell",
                np.where(field.cells.count > 0, field.cells.count, np.nan),
                None,
                "points",
            ),
        )
        for place, (name, values, most, unit) in enumerate(panels):
            left = _LEFT + place * (_PANEL_WIDTH + _GAP)
            axes = axes_at(figure, left, top + _CAPTION, _PANEL_WIDTH, height)
            bar = axes_at(figure, left + _PANEL_WIDTH + 0.12, top + _CAPTION, 0.14, height)
            axes.set_title(name, loc="left")
            _draw(figure, axes, bar, field, values, most, unit)
            if place == 0:
                _label(axes, field)
        top += row
    handles = [Patch(**_BLANK, label="no grid point: the lens model extrapolates")]
    if any(not np.isfinite(field.uncertainty_px).all() for field in fields):
        handles.append(Patch(facecolor="white", edgecolor=FAINT, label="no direction by the lens model"))
    figure.legend(handles=handles, loc="lower center", ncols=2)
    return figure


def _caption(field: ProjectionField) -> tuple[str, str, str]:
    noun = "image" if field.images == 1 else "images"
    first = (
        f"Focus group {short(field.focus_group)}   ·   {field.images:,} {noun}   ·   "
        f"points in {100.0 * field.cells.covered_share:.0f} % of the image"
    )
    blank = [area.name for area in field.areas if area.is_blank]
    named = (
        "every part of the image"
        if len(blank) == len(field.areas)
        else ", ".join(blank) or "no part of the image"
    )
    return first, f"blank: {named}", _uncertainty(field)


def _uncertainty(field: ProjectionField) -> str:
    covered, beyond = field.largest_covered_px, field.largest_blank_px
    if covered == 0.0:
        return "intrinsics were given and are taken as exact: no uncertainty is stated"
    parts = [] if covered is None else [f"{covered:.2g} px where there are points"]
    parts += [] if beyond is None else [f"{beyond:.2g} px elsewhere"]
    if not parts:
        return "the lens model has no direction in any part of the image"
    return f"largest: {', '.join(parts)}; what a rotation of the camera takes up is compensated"


def _draw(
    figure: Figure,
    axes: Axes,
    bar: Axes,
    field: ProjectionField,
    values: Float[np.ndarray, "r c"],
    most: float | None,
    unit: str,
) -> None:
    cells = field.cells
    frame_image(axes, cells.width_px, cells.height_px)
    known = values[np.isfinite(values)]
    largest = float(known.max()) if len(known) else 0.0
    top = (most or largest) or 1.0
    extend = "max" if largest > top else "neither"
    draw_cells(figure, axes, bar, values, cells.size_px, top, unit, extend=extend)
    for row, column in np.argwhere(cells.count == 0):
        corner = (column * cells.size_px - 0.5, row * cells.size_px - 0.5)
        axes.add_patch(Rectangle(corner, cells.size_px, cells.size_px, **_BLANK))
    if unit == "points":
        bar.yaxis.set_major_locator(MaxNLocator(6, integer=True))


def _label(axes: Axes, field: ProjectionField) -> None:
    """Write the largest uncertainty of each area in its middle: figures stay readable in grey."""
    cells = field.cells
    for place, area in enumerate(field.areas):
        if area.standard_uncertainty_px is None:
            continue
        u = (place % 3 + 0.5) * cells.width_px / 3.0
        v = (place // 3 + 0.5) * cells.height_px / 3.0
        axes.text(
            u,
            v,
            f"{area.standard_uncertainty_px:.2g}",
            ha="center",
            va="center",
            fontsize=9,
            color=INK,
            path_effects=[withStroke(linewidth=3.5, foreground="white")],
        )
