"""What each joint turns by beyond its stated angle: the curve, its 95 % band, and the angles at which it was."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from app.reports.svg import BLUE, FAINT, INK, NORMAL_95, SKY, PanelText, draw_svg, panel_grid, unsigned_zero

_FOOTER = 0.7
_MARGIN = 0.06
"""Of the range of angles: what is drawn on both sides of it, hatched."""
_RUG = 0.07
"""Of the height: the marks of visited angles."""
_MAX_VECTORS, _MAX_NAMED = 3000, 2


@dataclass(frozen=True, slots=True)
class JointCurvePanel:
    """One joint: its curve over the stated angle, the angles visited, and gaps that were never visited; degrees."""

    name: str
    angles_deg: Float[np.ndarray, " a"]
    correction_deg: Float[np.ndarray, " a"]
    standard_uncertainty_deg: Float[np.ndarray, " a"]
    visited_deg: Float[np.ndarray, " n"]
    gaps_deg: Sequence[tuple[float, float]]

    @property
    def caption(self) -> str:
        largest = int(np.argmax(np.abs(self.correction_deg)))
        value = 1e3 * float(self.correction_deg[largest])
        half = 1e3 * NORMAL_95 * float(self.standard_uncertainty_deg[largest])
        decimals = 2 if half <= 0.0 else min(6, max(0, 1 - math.floor(math.log10(half))))
        return (
            f"largest correction {unsigned_zero(f'{value:.{decimals}f}')} ± {half:.{decimals}f} mdeg at "
            f"{_whole(self.angles_deg[largest])}°"
        )

    @property
    def unvisited(self) -> str:
        """Return which angles between those visited never were; empty without any."""
        gaps = ", ".join(f"{_whole(low)}° to {_whole(high)}°" for low, high in self.gaps_deg[:_MAX_NAMED])
        if len(self.gaps_deg) > _MAX_NAMED:
            gaps += f" and {len(self.gaps_deg) - _MAX_NAMED} more"
        return f"not visited: {gaps}" if gaps else ""


def _whole(angle_deg: float) -> str:
    return unsigned_zero(f"{angle_deg:.0f}")


def _described(panel: JointCurvePanel) -> str:
    return f"{panel.name}: " + "   ·   ".join(filter(None, (panel.caption, panel.unvisited)))


def joint_curves_svg(panels: Sequence[JointCurvePanel], title: str, summary: str, about: str = "") -> bytes:
    """Return a panel for each joint; `summary` says what was chosen and why."""
    described = [summary, *map(_described, panels)]
    return draw_svg(lambda: joint_curves_figure(panels, title, summary), title, "\n".join(described), about)


def joint_curves_figure(panels: Sequence[JointCurvePanel], title: str, summary: str) -> Figure:
    """Draw it; within `drawing_style`."""
    rasterized = sum(len(panel.visited_deg) for panel in panels) > _MAX_VECTORS
    figure = panel_grid(
        [PanelText(panel.name, panel.caption, panel.unvisited) for panel in panels],
        title,
        summary,
        _FOOTER,
        lambda axes, number: _draw(axes, panels[number], rasterized),
    )
    figure.legend(handles=_legend(), loc="lower center", ncols=4, columnspacing=1.6, handletextpad=0.6)
    return figure


def _draw(axes: Axes, panel: JointCurvePanel, rasterized: bool) -> None:
    correction, band = 1e3 * panel.correction_deg, 1e3 * NORMAL_95 * panel.standard_uncertainty_deg
    low, high = float(panel.angles_deg[0]), float(panel.angles_deg[-1])
    margin = max(_MARGIN * (high - low), 1.0)
    axes.axhline(0.0, color=INK, lw=0.7, zorder=1)
    for first, last in ((low - margin, low), *panel.gaps_deg, (high, high + margin)):
        axes.axvspan(first, last, facecolor="none", edgecolor=FAINT, hatch="////", lw=0.0, zorder=0)
    axes.fill_between(panel.angles_deg, correction - band, correction + band, color=SKY, alpha=0.7, lw=0.0)
    axes.plot(panel.angles_deg, correction, color=BLUE, lw=1.5, zorder=3)
    axes.vlines(
        panel.visited_deg,
        0.0,
        _RUG,
        transform=axes.get_xaxis_transform(),
        color=INK,
        lw=0.5,
        alpha=0.6,
        zorder=2,
        rasterized=rasterized,
    )
    axes.set_xlim(low - margin, high + margin)
    reach = max(float(np.max(np.abs(correction) + band)), 1.0)
    axes.set_ylim(-1.3 * reach, 1.15 * reach)
    axes.xaxis.set_major_locator(MaxNLocator(8))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.set_xlabel("stated angle, °")
    axes.set_ylabel("correction, mdeg", labelpad=2)


def _legend() -> list[Any]:
    return [
        Line2D([], [], color=BLUE, lw=1.5, label="correction"),
        Patch(color=SKY, alpha=0.7, lw=0.0, label="its 95 % band"),
        Line2D([], [], color=INK, marker="|", ls="none", ms=7, label="angles visited"),
        Patch(facecolor="none", edgecolor=FAINT, hatch="////", lw=0.0, label="never visited"),
    ]
