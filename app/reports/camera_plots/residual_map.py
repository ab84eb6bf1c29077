"""Mean residuals of the lens model over the image: where one remains, the model does not fit."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from app.reports.camera_plots.image_axes import draw_cells, frame_image
from app.reports.camera_plots.residual_cells import (
    MIN_POINTS_IN_CELL,
    Cells,
    ResidualField,
    cells_of,
    residual_figures,
)
from app.reports.svg import FAINT, NAVY, axes_at, draw_svg, short, text_at

_LEFT, _PANEL_WIDTH, _GAP = 0.8, 4.6, 0.85
_HEADER, _CAPTION, _BELOW, _FOOTER = 0.62, 0.78, 0.62, 0.6


def residuals_svg(fields: Sequence[ResidualField], title: str, about: str = "") -> bytes:
    """Return for every focus group the mean residuals and their size over the image."""
    cells = [cells_of(field) for field in fields]
    return draw_svg(
        lambda: residuals_figure(fields, cells, title),
        title,
        "\n".join(" ".join(_caption(f, c)) for f, c in zip(fields, cells, strict=True)),
        about,
    )


def residuals_figure(fields: Sequence[ResidualField], cells: Sequence[Cells], title: str) -> Figure:
    """Draw it; within `drawing_style`."""
    heights = [min(_PANEL_WIDTH * f.height_px / f.width_px, 9.0) for f in fields]
    rows = [_CAPTION + height + _BELOW for height in heights]
    figure = Figure((_LEFT + 2 * _PANEL_WIDTH + _GAP + 1.0, _HEADER + sum(rows) + _FOOTER))
    text_at(figure, 0.15, 0.32, title, fontsize=12, weight="bold")
    top = _HEADER
    for field, found, height, row in zip(fields, cells, heights, rows, strict=True):
        first, second = _caption(field, found)
        text_at(figure, 0.15, top + 0.12, first)
        text_at(figure, 0.15, top + 0.34, second, color="#555555", fontsize=8)
        _draw_means(figure, axes_at(figure, _LEFT, top + _CAPTION, _PANEL_WIDTH, height), field, found)
        left = _LEFT + _PANEL_WIDTH + _GAP
        axes = axes_at(figure, left, top + _CAPTION, _PANEL_WIDTH, height)
        bar = axes_at(figure, left + _PANEL_WIDTH + 0.12, top + _CAPTION, 0.14, height)
        _draw_sizes(figure, axes, bar, field, found)
        top += row
    figure.legend(
        handles=[
            Line2D(
                [],
                [],
                color=NAVY,
                lw=1.6,
                label="mean residual that chance explains in 1 cell of 100 at most",
            ),
            Line2D([], [], color=FAINT, lw=1.6, label="the others"),
        ],
        loc="lower center",
        ncols=2,
    )
    return figure


def _caption(field: ResidualField, cells: Cells) -> tuple[str, str]:
    figures = residual_figures(field, cells)
    gone = f", {figures.outlier_count:,} excluded as outliers" if figures.outlier_count else ""
    noun = "image" if field.images == 1 else "images"
    first = (
        f"Focus group {short(field.focus_group)}   ·   {field.images:,} {noun}   ·   "
        f"{figures.point_count:,} points{gone}   ·   rms {figures.rms_px:.3g} px"
    )
    if not figures.cells:
        return first, f"no cell has {MIN_POINTS_IN_CELL} points"
    return first, (
        f"{figures.cells_beyond_chance} of {figures.cells} cells have a mean residual beyond chance (chance alone: "
        f"{figures.cells_by_chance:.1f}); mean residuals have an rms of {figures.mean_rms_px:.2g} px"
    )


def _draw_means(figure: Figure, axes: Axes, field: ResidualField, cells: Cells) -> None:
    frame_image(axes, field.width_px, field.height_px)
    axes.set_title("mean residual, observed − predicted", loc="left")
    lengths = np.linalg.norm(cells.mean_px, axis=1)
    if not len(lengths) or not lengths.any():
        return
    # The longest arrows fill their cell; one stray cell does not make all others invisible.
    unit = _round_down(float(np.quantile(lengths, 0.95)))
    scale = 0.95 * cells.size_px / max(float(np.quantile(lengths, 0.95)), 1e-12)
    colours = np.where(cells.stands_out, NAVY, FAINT)
    start = cells.middle_px - 0.5 * scale * cells.mean_px
    arrows = axes.quiver(
        start[:, 0],
        start[:, 1],
        cells.mean_px[:, 0],
        cells.mean_px[:, 1],
        color=colours.tolist(),
        angles="xy",
        scale_units="xy",
        scale=1.0 / scale,
        width=0.0042,
        headwidth=3.6,
        headlength=4.2,
        headaxislength=3.8,
        clip_on=False,  # an arrow without its head points nowhere
    )
    above = 1.0 + 0.12 / (axes.get_position().height * figure.get_size_inches()[1])
    axes.quiverkey(
        arrows, 0.82, above, unit, f"{unit:g} px", labelpos="E", coordinates="axes", labelsep=0.06, color=NAVY
    )


def _draw_sizes(figure: Figure, axes: Axes, bar: Axes, field: ResidualField, cells: Cells) -> None:
    frame_image(axes, field.width_px, field.height_px)
    axes.set_title("size of the residuals (rms distance)", loc="left")
    columns, rows = (math.ceil(side / cells.size_px) for side in (field.width_px, field.height_px))
    grid = np.full((rows, columns), np.nan)
    place = np.floor((cells.middle_px + 0.5) / cells.size_px).astype(np.intp)
    grid[place[:, 1], place[:, 0]] = cells.rms_px
    top = float(np.quantile(cells.rms_px, 0.98)) if len(cells.rms_px) else 1.0
    draw_cells(figure, axes, bar, grid, cells.size_px, top if top > 0.0 else 1.0, "px", extend="max")


def _round_down(value: float) -> float:
    """Return the largest of 1, 2, 5 · 10ᵏ that is no larger."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-9))
