"""Control charts of a robot's figures: single sessions with their limits, the EWMA, and where the level changed."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from app.reports.svg import BLUE, FAINT, INK, ORANGE, RED, axes_at, draw_svg, short, text_at

_LEFT, _WIDTH, _HEIGHT, _EWMA_HEIGHT = 0.95, 6.6, 1.7, 0.95
_HEADER, _CAPTION, _BETWEEN, _BELOW = 0.62, 0.62, 0.12, 0.6
_LETTERS = 108
"""Letters of small type in a line; a sentence has two lines at most, and stands whole in the description."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartedFigure:
    """One figure over n sessions in time order, with the limits of its chart.

    `places` are where the sessions stand on the axis: their numbers, or `by_date` days since 1970 (UTC). `ewma` is NaN
    for points without a score. `since` and `at` are the points from which on the level is another, and where that was
    shown; None without an alarm. `events` are where on the axis something was done to the robot.
    """

    name: str
    unit: str
    by_date: bool
    places: Float[np.ndarray, " n"]
    values: Float[np.ndarray, " n"]
    centre: float
    lower: float
    upper: float
    outside: tuple[int, ...]
    ewma: Float[np.ndarray, " n"]
    ewma_limit: float
    since: int | None
    at: int | None
    sentence: str
    events: tuple[float, ...] = ()


def control_chart_svg(charts: Sequence[ChartedFigure], title: str) -> bytes:
    """Return two panels for every figure, one above the other."""
    described = "\n".join(f"{chart.name}: {chart.sentence}" for chart in charts)
    return draw_svg(lambda: control_chart_figure(charts, title), title, described)


def control_chart_figure(charts: Sequence[ChartedFigure], title: str) -> Figure:
    """Draw it; within `drawing_style`."""
    row = _CAPTION + _HEIGHT + _BETWEEN + _EWMA_HEIGHT + _BELOW
    figure = Figure((_LEFT + _WIDTH + 0.25, _HEADER + row * len(charts)))
    text_at(figure, 0.15, 0.32, short(title), fontsize=12, weight="bold")
    for place, chart in enumerate(charts):
        top = _HEADER + place * row
        text_at(figure, _LEFT, top + 0.1, short(chart.name), fontsize=10, weight="bold")
        for line, text in enumerate(textwrap.wrap(chart.sentence, _LETTERS)[:2]):
            text_at(figure, _LEFT, top + 0.31 + 0.16 * line, text, color="#555555", fontsize=8)
        above = axes_at(figure, _LEFT, top + _CAPTION, _WIDTH, _HEIGHT)
        below = axes_at(figure, _LEFT, top + _CAPTION + _HEIGHT + _BETWEEN, _WIDTH, _EWMA_HEIGHT)
        _draw_individuals(above, chart)
        _draw_ewma(below, chart)
    return figure


def _draw_individuals(axes: Axes, chart: ChartedFigure) -> None:
    for level, style in ((chart.lower, "--"), (chart.centre, "-"), (chart.upper, "--")):
        axes.axhline(level, color=FAINT, linestyle=style, linewidth=0.9)
    axes.plot(chart.places, chart.values, color=BLUE, marker="o", markersize=3.5)
    outside = list(chart.outside)
    axes.plot(chart.places[outside], chart.values[outside], "o", color=RED, markersize=7, fillstyle="none")
    # A constant figure's limits are off by adding numbers: no range to draw.
    if np.ptp(axes.get_ylim()) < 1e-9 * abs(chart.centre):
        axes.set_ylim(*sorted((0.95 * chart.centre, 1.05 * chart.centre)))
    axes.set_ylabel(chart.unit)
    _mark(axes, chart)
    axes.tick_params(labelbottom=False)
    axes.xaxis.get_offset_text().set_visible(False)


def _draw_ewma(axes: Axes, chart: ChartedFigure) -> None:
    for level in (-chart.ewma_limit, chart.ewma_limit):
        axes.axhline(level, color=FAINT, linestyle="--", linewidth=0.9)
    axes.axhline(0.0, color=FAINT, linewidth=0.9)
    axes.plot(chart.places, chart.ewma, color=ORANGE, marker="s", markersize=3.0)
    # Two levels may show while the EWMA is within its limits.
    if chart.at is not None and abs(chart.ewma[chart.at]) > chart.ewma_limit:
        axes.plot(
            chart.places[chart.at], chart.ewma[chart.at], "o", color=RED, markersize=7, fillstyle="none"
        )
    reach = 1.3 * max(chart.ewma_limit, float(np.nanmax(np.abs(chart.ewma), initial=0.0)))
    axes.set_ylim(-reach, reach)
    axes.set_ylabel("EWMA")
    axes.set_xlabel("measured, UTC" if chart.by_date else "session")
    _mark(axes, chart)


def _mark(axes: Axes, chart: ChartedFigure) -> None:
    """Mark since when the level is another, and what was done to the robot, between the sessions.

    Both are often at one place: a change follows what was done. The event is narrow and above, with a mark at the top.
    """
    if chart.since is not None:
        before = chart.places[max(chart.since - 1, 0)]
        axes.axvline(0.5 * float(before + chart.places[chart.since]), color=RED, linewidth=2.4, alpha=0.6)
    for place in chart.events:
        axes.axvline(place, color=INK, linestyle=":", linewidth=1.1, zorder=3.0)
        axes.plot(
            [place],
            [1.0],
            marker="v",
            markersize=6.0,
            color=INK,
            transform=axes.get_xaxis_transform(),
            clip_on=False,
            zorder=3.0,
        )
    first, last = float(chart.places[0]), float(chart.places[-1])
    if chart.by_date:
        locator = AutoDateLocator(minticks=3, maxticks=8)  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
        edge = 0.03 * (last - first)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        edge = 0.6
    axes.set_xlim(first - edge, last + edge)
