"""Maps of a figure over a robot's workspace: distance from the first axis, and height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from app.reports.svg import INK, axes_at, draw_svg, text_at

_LEFT, _PANEL, _GAP, _BAR = 0.8, 3.6, 0.75, 1.1
_HEADER, _LINE, _CAPTION, _FOOTER = 0.78, 0.22, 0.25, 0.7
_COLOURS = "viridis"
_SMALL = 0.4
"""Of a cell's width: what is extrapolated only."""
EXTRAPOLATED = (
    "Small squares: beyond the joint angles of the measured poses, extrapolated. Circles: measured poses."
)


@dataclass(frozen=True, slots=True)
class PlaceCell:
    """Middle of a cell, mm, and a value for each panel, mm.

    `measured` poses lie in it; an `extrapolated` one is known by extrapolation only.
    """

    radius_mm: float
    height_mm: float
    values: tuple[float, ...]
    measured: bool = False
    extrapolated: bool = False


@dataclass(frozen=True, slots=True)
class MapPanel:
    """A panel: its name, what its colours are, and the end of its scale, mm, whose colour larger values have."""

    name: str
    label: str
    top_mm: float


@dataclass(frozen=True, slots=True)
class MarkedPlace:
    """The place that is marked, mm, and what is said of it and of the map."""

    radius_mm: float
    height_mm: float
    lines: tuple[str, ...]


def workspace_map_svg(
    cells: Sequence[PlaceCell],
    cell_mm: float,
    panels: Sequence[MapPanel],
    marked: MarkedPlace,
    title: str,
    about: str = "",
) -> bytes:
    """Return a panel for each value of the cells; neighbours of one scale share its bar."""
    return draw_svg(
        lambda: workspace_map_figure(cells, cell_mm, panels, marked, title),
        title,
        " ".join(marked.lines),
        about,
    )


def workspace_map_figure(
    cells: Sequence[PlaceCell], cell_mm: float, panels: Sequence[MapPanel], marked: MarkedPlace, title: str
) -> Figure:
    """Draw it; within `drawing_style`."""
    low = min(cell.height_mm for cell in cells) - cell_mm
    high = max(cell.height_mm for cell in cells) + cell_mm
    right = max(cell.radius_mm for cell in cells) + cell_mm
    height = min(max(_PANEL * (high - low) / right, 1.5), 8.0)
    top = _HEADER + _LINE * (len(marked.lines) - 1) + _CAPTION
    with_bar = [
        panel is panels[-1] or (panel.label, panel.top_mm) != (after.label, after.top_mm)
        for panel, after in zip(panels, [*panels[1:], panels[-1]], strict=True)
    ]
    width = _LEFT + len(panels) * _PANEL + (len(panels) - 1) * _GAP + sum(with_bar) * _BAR
    figure = Figure((width, top + height + _FOOTER))
    text_at(figure, 0.15, 0.32, title, fontsize=12, weight="bold")
    for number, line in enumerate(marked.lines):
        text_at(figure, 0.15, 0.58 + _LINE * number, line)
    left = _LEFT
    for number, (panel, has_bar) in enumerate(zip(panels, with_bar, strict=True)):
        axes = axes_at(figure, left, top, _PANEL, height)
        drawn = _draw(axes, cells, number, cell_mm, Normalize(0.0, panel.top_mm))
        axes.set_title(panel.name)
        axes.set_xlim(0.0, right)
        axes.set_ylim(low, high)
        axes.set_xlabel("distance from the first axis, mm")
        axes.plot([marked.radius_mm], [marked.height_mm], marker="x", color="white", markersize=9, mew=3.6)
        axes.plot([marked.radius_mm], [marked.height_mm], marker="x", color=INK, markersize=7, mew=1.6)
        left += _PANEL
        if has_bar:
            beyond = any(cell.values[number] > panel.top_mm * (1.0 + 1e-9) for cell in cells)
            bar = axes_at(figure, left + 0.15, top, 0.16, height)
            figure.colorbar(drawn, cax=bar, extend="max" if beyond else "neither").set_label(panel.label)
            left += _BAR
        left += _GAP
    figure.axes[0].set_ylabel("height, mm")
    return figure


def _draw(
    axes: Axes, cells: Sequence[PlaceCell], number: int, cell_mm: float, norm: Normalize
) -> PatchCollection:
    boxes = PatchCollection(
        [_box(cell, _SMALL * cell_mm if cell.extrapolated else cell_mm) for cell in cells],
        cmap=_COLOURS,
        norm=norm,
        edgecolor="none",
    )
    boxes.set_array([cell.values[number] for cell in cells])
    axes.add_collection(boxes)
    axes.set_axisbelow(True)
    measured = [cell for cell in cells if cell.measured]
    if measured:
        radii, heights = [cell.radius_mm for cell in measured], [cell.height_mm for cell in measured]
        axes.scatter(radii, heights, s=13, facecolor="white", edgecolor=INK, linewidth=0.8, zorder=3)
    return boxes


def _box(cell: PlaceCell, size: float) -> Rectangle:
    return Rectangle((cell.radius_mm - 0.5 * size, cell.height_mm - 0.5 * size), size, size)
