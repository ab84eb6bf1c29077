"""Predicted repeatability over a robot's workspace: distance from the first axis, and height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from app.reports.svg import INK, axes_at, draw_svg, millimetres, text_at, unsigned_zero

_LEFT, _PANEL, _GAP = 0.8, 3.6, 0.75
_HEADER, _CAPTION, _FOOTER = 0.95, 0.3, 0.7
_COLOURS = "viridis"


@dataclass(frozen=True, slots=True)
class RepeatabilityCell:
    """Middle of a cell, and RP_l of the configurations that reach it; mm."""

    radius_mm: float
    height_mm: float
    median_rp_l_mm: float
    largest_rp_l_mm: float


@dataclass(frozen=True, slots=True)
class WorstPoint:
    """Where RP_l is largest: radius and height, RP_l with its interval, mm."""

    radius_mm: float
    height_mm: float
    rp_l_mm: float
    interval_mm: tuple[float, float]


def repeatability_map_svg(
    cells: Sequence[RepeatabilityCell], cell_mm: float, worst: WorstPoint, title: str, about: str = ""
) -> bytes:
    """Return the median and the largest RP_l of every cell side by side, on one scale."""
    return draw_svg(
        lambda: repeatability_map_figure(cells, cell_mm, worst, title), title, _caption(worst), about
    )


def repeatability_map_figure(
    cells: Sequence[RepeatabilityCell], cell_mm: float, worst: WorstPoint, title: str
) -> Figure:
    """Draw it; within `drawing_style`."""
    low = min(cell.height_mm for cell in cells) - cell_mm
    high = max(cell.height_mm for cell in cells) + cell_mm
    right = max(cell.radius_mm for cell in cells) + cell_mm
    height = min(max(_PANEL * (high - low) / right, 1.5), 8.0)
    figure = Figure((_LEFT + 2 * _PANEL + _GAP + 1.1, _HEADER + _CAPTION + height + _FOOTER))
    text_at(figure, 0.15, 0.32, title, fontsize=12, weight="bold")
    text_at(figure, 0.15, 0.6, _caption(worst))
    norm = Normalize(0.0, worst.rp_l_mm)
    drawn = None
    for column, (name, values) in enumerate(
        (
            ("median of the configurations", [cell.median_rp_l_mm for cell in cells]),
            ("largest", [cell.largest_rp_l_mm for cell in cells]),
        )
    ):
        left = _LEFT + column * (_PANEL + _GAP)
        axes = axes_at(figure, left, _HEADER + _CAPTION, _PANEL, height)
        drawn = _draw(axes, cells, values, cell_mm, norm)
        axes.set_title(name)
        axes.set_xlim(0.0, right)
        axes.set_ylim(low, high)
        axes.set_xlabel("distance from the first axis, mm")
        axes.plot([worst.radius_mm], [worst.height_mm], marker="x", color=INK, markersize=7, mew=1.6)
    figure.axes[0].set_ylabel("height, mm")
    bar = axes_at(figure, _LEFT + 2 * _PANEL + _GAP + 0.15, _HEADER + _CAPTION, 0.16, height)
    assert drawn is not None
    figure.colorbar(drawn, cax=bar).set_label("RP_l, mm")
    return figure


def _draw(
    axes: Axes,
    cells: Sequence[RepeatabilityCell],
    values: Sequence[float],
    cell_mm: float,
    norm: Normalize,
) -> PatchCollection:
    half = 0.5 * cell_mm
    boxes = PatchCollection(
        [Rectangle((cell.radius_mm - half, cell.height_mm - half), cell_mm, cell_mm) for cell in cells],
        cmap=_COLOURS,
        norm=norm,
        edgecolor="none",
    )
    boxes.set_array(values)
    axes.add_collection(boxes)
    axes.set_axisbelow(False)
    return boxes


def _caption(worst: WorstPoint) -> str:
    low, high = (millimetres(value) for value in worst.interval_mm)
    return (
        f"Worst place (×): RP_l {millimetres(worst.rp_l_mm)} mm [{low}, {high}] at radius {worst.radius_mm:.0f} mm, "
        f"height {unsigned_zero(f'{worst.height_mm:.0f}')} mm"
    )
