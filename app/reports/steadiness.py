"""The cycles in their order: the motion that all poses share, and each pose's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from app.reports.svg import BLUE, FAINT, GREEN, INK, ORANGE, RED, PanelText, draw_svg, panel_grid

_AXES = (("x", BLUE, "o"), ("y", ORANGE, "s"), ("z", GREEN, "^"))
_FOOTER = 0.78
_MAX_VECTORS = 3000
"""Points that are drawn one by one; more of them are rasterised."""


_CHANCE: dict[str, Any] = {"color": INK, "lw": 0.9, "ls": (0, (1, 2))}


@dataclass(frozen=True, slots=True)
class SteadinessPanel:
    """One series over the cycles: offsets along x, y, z from its mean, mm.

    `moved` says by how much its trend moved it. `line_mm` is its trend at the first and the last cycle, `change_cycle`
    the first cycle after a step; None where nothing is to be shown. `second` marks visits at a second stopping point.
    `by_chance_mm` is the change from first to last below which 95 % of the trends of steady cycles stay, along the axis
    that scatters most.
    """

    name: str
    caption: str
    moved: str
    steady: bool
    cycles: Int[np.ndarray, " n"]
    offsets_mm: Float[np.ndarray, "n 3"]
    line_mm: Float[np.ndarray, "2 3"] | None
    change_cycle: int | None
    second: Bool[np.ndarray, " n"]
    by_chance_mm: float = 0.0


def steadiness_svg(
    panels: Sequence[SteadinessPanel], title: str, summary: str, counted_in: str, about: str = ""
) -> bytes:
    """Return a panel for each series, x, y and z over the cycles; `summary` says what was found."""
    described = [summary, *(f"{panel.name}: {_found(panel)}   ·   {panel.moved}" for panel in panels)]
    return draw_svg(
        lambda: steadiness_figure(panels, title, summary, counted_in), title, "\n".join(described), about
    )


def steadiness_figure(panels: Sequence[SteadinessPanel], title: str, summary: str, counted_in: str) -> Figure:
    """Draw it; within `drawing_style`."""
    rasterized = sum(panel.offsets_mm.size for panel in panels) > _MAX_VECTORS
    figure = panel_grid(
        [PanelText(panel.name, _found(panel), panel.moved, INK if panel.steady else RED) for panel in panels],
        title,
        summary,
        _FOOTER,
        lambda axes, number: _draw(axes, panels[number], rasterized, counted_in),
    )
    figure.legend(
        handles=_legend(panels),
        loc="lower center",
        ncols=2 if len(panels) == 1 else 3,
        columnspacing=1.6,
        handletextpad=0.6,
    )
    return figure


def _found(panel: SteadinessPanel) -> str:
    return panel.caption if panel.steady else "   ·   ".join(filter(None, ("not steady", panel.caption)))


def _draw(axes: Axes, panel: SteadinessPanel, rasterized: bool, counted_in: str) -> None:
    reach = float(np.abs(panel.offsets_mm).max(initial=0.0))
    unit, factor = ("mm", 1.0) if reach >= 0.1 else ("µm", 1e3)
    axes.axhline(0.0, color=INK, lw=0.7, zorder=1)
    if panel.change_cycle is not None:
        axes.axvline(panel.change_cycle - 0.5, color=RED, lw=1.2, ls=(0, (4, 3)), zorder=1)
    ends = [float(panel.cycles.min()), float(panel.cycles.max())]
    for axis, (_, colour, marker) in enumerate(_AXES):
        for chosen, face in ((~panel.second, colour), (panel.second, "white")):
            axes.plot(
                panel.cycles[chosen] + 0.16 * (axis - 1),
                panel.offsets_mm[chosen, axis] * factor,
                marker=marker,
                ms=3.4,
                mec=colour,
                mfc=face,
                mew=0.9,
                alpha=0.75,
                ls="none",
                zorder=2,
                rasterized=rasterized,
            )
        if panel.line_mm is not None:
            axes.plot(
                ends, panel.line_mm[:, axis] * factor, color=colour, lw=1.7, marker=marker, ms=5, zorder=3
            )
    if panel.by_chance_mm > 0.0:
        for side in (-0.5, 0.5):
            limit = side * panel.by_chance_mm * factor
            axes.plot(ends, (-limit, limit), **_CHANCE, zorder=1.5)
    axes.set_xlim(ends[0] - 1.0, ends[1] + 1.0)
    if reach == 0.0:
        axes.set_ylim(-1.0, 1.0)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel(counted_in)
    axes.set_ylabel(f"off the mean, {unit}", labelpad=2)


def _legend(panels: Sequence[SteadinessPanel]) -> list[Any]:
    trends = any(panel.line_mm is not None for panel in panels)
    line: dict[str, Any] = {"lw": 1.7} if trends else {"ls": "none"}
    handles = [
        Line2D(
            [],
            [],
            marker=marker,
            color=colour,
            ms=4,
            mew=0,
            label=f"{name}: cycle{', trend' * trends}",
            **line,
        )
        for name, colour, marker in _AXES
    ]
    if any(panel.by_chance_mm > 0.0 for panel in panels):
        handles.append(Line2D([], [], **_CHANCE, label="chance alone: 95 % of trends, widest axis"))
    if any(panel.change_cycle is not None for panel in panels):
        handles.append(Line2D([], [], color=RED, lw=1.2, ls=(0, (4, 3)), label="largest step"))
    if any(panel.second.any() for panel in panels):
        label = "second stopping point"
        handles.append(Line2D([], [], marker="o", mfc="white", mec=FAINT, ms=4, ls="none", label=label))
    return handles
