"""The control charts of a history as one drawing; what draws runs in a process of the analyses."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any, Literal

from app.analyses.history.charting import HistoryEvent
from app.analyses.history.over_time import ChartedTest

ChartAxis = Literal["date", "session"]
_DAY_S = 86400.0
MAX_CHARTS = 24
"""Charts of one drawing: those of tests that come first."""


def charts_of_tests(
    tests: Sequence[ChartedTest], events: Sequence[HistoryEvent], axis: ChartAxis = "date"
) -> list[dict[str, Any]]:
    """Return what `draw_charts` takes of tests: the fields of `ChartedFigure`, as plain values.

    Sessions stand by their number where all were measured at one time, too.
    """
    found = []
    for test in tests:
        for key, chart in test.charts.items():
            series = test.series[key]
            times = [report.measured_at for report, _ in series]
            by_date = axis == "date" and times[-1] > times[0]
            between = {
                _days(event.at) if by_date else after + 0.5
                for event in events
                if 0 < (after := sum(time < event.at for time in times)) < len(times)
            }
            alarm = chart.alarm
            found.append(
                {
                    "name": f"{' '.join(reversed(key))}, test {test.number}",
                    "unit": series[0][1].unit,
                    "by_date": by_date,
                    "places": [
                        _days(time) if by_date else number for number, time in enumerate(times, start=1)
                    ],
                    "values": chart.values.tolist(),
                    "centre": chart.limits.centre,
                    "lower": chart.limits.lower,
                    "upper": chart.limits.upper,
                    "outside": chart.outside,
                    "ewma": chart.ewma.tolist(),
                    "ewma_limit": chart.ewma_limit,
                    "since": alarm.since if alarm is not None else None,
                    "at": alarm.at if alarm is not None else None,
                    "sentence": test.sentences.get(key, "No lasting change is shown."),
                    "events": tuple(sorted(between)),
                }
            )
    return found[:MAX_CHARTS]


def _days(moment: str) -> float:
    """Return the days from 1970 (UTC) to a moment by RFC 3339."""
    return datetime.fromisoformat(moment).timestamp() / _DAY_S


def draw_charts(charts: Sequence[dict[str, Any]], title: str) -> bytes:
    """Return the charts as SVG, one above the other; runs in a process alongside the head, which loads no plotting."""
    import numpy as np

    from app.reports.control_chart import ChartedFigure, control_chart_svg

    arrays = (
        {name: np.asarray(chart[name], float) for name in ("places", "values", "ewma")} for chart in charts
    )
    return control_chart_svg(
        [ChartedFigure(**{**chart, **of_chart}) for chart, of_chart in zip(charts, arrays, strict=True)],
        title,
    )
