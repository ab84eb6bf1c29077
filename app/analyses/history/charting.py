"""The figures of comparable sessions as series over time, their control charts, and what changed lastingly."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from app.analyses.history.likeness import poses_in
from app.analyses.history.summaries import Figure, Key, Summary, over_poses
from core.metrology import ControlChart, chart_figure

MIN_SESSIONS = 5
"""Sessions that are comparable, below which no chart is drawn."""
SESSIONS_BETWEEN_FALSE_ALARMS = 370.0


@dataclass(frozen=True, slots=True)
class HistoryEvent:
    """Something done to the robot; `restarts_charts` where figures before and after it are not to be compared."""

    event_id: str
    at: str
    note: str
    restarts_charts: bool


Series = list[tuple[Summary, Figure]]
Charts = dict[Key, ControlChart]


def series_of(test: Sequence[Summary]) -> dict[Key, Series]:
    """Return the figures of a test over its sessions: of poses their geometric mean, where these are the same."""
    found: dict[Key, Series] = {}
    for report in test:
        for key, figure in over_poses(report.figures, poses_in(report.poses)).items():
            found.setdefault(key, []).append((report, figure))
    return found


def charts_of(test: dict[Key, Series]) -> Charts:
    """Return the charts of a test's series that are long enough; they share the test's rate of false alarms."""
    enough = {key: series for key, series in test.items() if len(series) >= MIN_SESSIONS}
    return {
        key: chart_figure(
            [figure.value for _, figure in series],
            logarithms=series[0][1].is_length,
            run_length=SESSIONS_BETWEEN_FALSE_ALARMS * len(enough),
        )
        for key, series in enough.items()
    }


def alarm_sentences(
    test: dict[Key, Series], charts: Charts, events: Sequence[HistoryEvent] = ()
) -> Iterator[tuple[Key, str]]:
    """Yield what changed lastingly, since when, by how much, and what was done to the robot at that time."""
    for key, series in test.items():
        chart = charts.get(key)
        if chart is None or chart.alarm is None:
            continue
        alarm = chart.alarm
        last, since, at = (series[k][0] for k in (alarm.since - 1, alarm.since, alarm.at))
        sentence = (
            f"{' '.join(reversed(key))} went {alarm.direction}, from {_levels(alarm.before, alarm.after)} "
            f"{series[0][1].unit}, since the session {since.session[1]} ({_day(since.measured_at)}); shown by "
            f"{at.session[1]} ({_day(at.measured_at)})."
        )
        between = [event for event in events if last.measured_at < event.at <= since.measured_at]
        if between:
            sentence += f" Before it: {'; '.join(f'{event.note} ({_day(event.at)})' for event in between)}."
        yield key, sentence


def _levels(before: float, after: float) -> str:
    """Return two levels to the second digit of their difference."""
    change = abs(after - before)
    places = min(max(1 - math.floor(math.log10(change)), 0), 9) if change > 0.0 else 3
    return f"{before:.{places}f} to {after:.{places}f}".replace("-", "−")


def _day(moment: str) -> str:
    """Return a moment of ISO 8601, in UTC, to the minute."""
    return f"{moment[:10]} {moment[11:16]} UTC" if "T" in moment else moment
