"""A robot over its sessions: tests of comparable sessions, their figures as points, limits, alarms and events."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from app.analyses.documents.qualification import charted_value
from app.analyses.history.charting import (
    SESSIONS_BETWEEN_FALSE_ALARMS,
    Charts,
    HistoryEvent,
    Series,
    alarm_sentences,
    charts_of,
    series_of,
)
from app.analyses.history.likeness import group_comparable, poses_in
from app.analyses.history.summaries import Figure, Key, Summary
from app.records.numbers import rounded
from core.metrology import ControlChart

Json = dict[str, Any]
_OF_QUALIFICATIONS = (
    ("worst_error_mm", "worst error", "mm", False),
    ("scale_ppm", "scale", "ppm", False),
    ("probing_scatter_mm", "probing scatter", "mm", True),
)
_NO_CONDITIONS = dict.fromkeys(("load_kg", "speed_percent", "temperature_c"))


@dataclass(frozen=True, slots=True)
class ChartedTest:
    """Comparable sessions with their figures and charts; `sentences` say what changed lastingly."""

    number: int
    reports: Sequence[Summary]
    series: Mapping[Key, Series]
    charts: Charts
    sentences: Mapping[Key, str]


def entries_of_qualifications(rows: Iterable[Mapping[str, Any]]) -> Iterator[Summary]:
    """Yield qualifications as entries of a history: those of one camera are comparable.

    A row has id, session_id, session_name, robot_id, camera_name, made_at and the charted figures.
    """
    for row in rows:
        yield Summary(
            report_id=row["id"],
            kind="qualification",
            made_at=as_text(row["made_at"]),
            measured_at=as_text(row["made_at"]),
            session=(row["session_id"], row["session_name"]),
            robot_id=row["robot_id"],
            source=row["camera_name"] or "",
            conditions=_NO_CONDITIONS,
            poses="{}",
            figures={
                ("qualification", name): Figure(charted_value(column, row[column]), None, unit, is_length)
                for column, name, unit, is_length in _OF_QUALIFICATIONS
                if row[column] is not None
            },
        )


def as_text(moment: datetime) -> str:
    """Return a time in UTC as summaries state it, so that texts are in the order of times."""
    return moment.isoformat().replace("+00:00", "Z")


def charted_tests(entries: Iterable[Summary], events: Sequence[HistoryEvent]) -> list[ChartedTest]:
    """Return the tests of a robot's latest reports of each session and kind, in time order."""
    restarts = [event.at for event in events if event.restarts_charts]
    tests = []
    for number, reports in enumerate(group_comparable(_latest(entries), restarts), start=1):
        series = series_of(reports)
        charts = charts_of(series)
        tests.append(
            ChartedTest(number, reports, series, charts, dict(alarm_sentences(series, charts, events)))
        )
    return tests


def history_document(
    robot: Mapping[str, str], tests: Sequence[ChartedTest], events: Sequence[HistoryEvent]
) -> Json:
    """Return a robot's history as the API shows it; `robot` has its id and name."""
    return {
        "robot_id": robot["id"],
        "robot_name": robot["name"],
        "sessions": len({report.session[0] for test in tests for report in test.reports}),
        "tests": [_test(test) for test in tests],
        "series": rounded(
            [_figure(test, key, series) for test in tests for key, series in test.series.items()]
        ),
        "events": [
            {
                "event_id": event.event_id,
                "at": event.at,
                "note": event.note,
                "restarts_charts": event.restarts_charts,
            }
            for event in events
        ],
        "session_figures": rounded(
            [
                figure
                for test in tests
                for key, series in test.series.items()
                for figure in _session_figures(test.number, key, series, test.charts.get(key))
            ]
        ),
    }


def _latest(entries: Iterable[Summary]) -> list[Summary]:
    """Return the latest report of each kind of each session, by the time of measurement; qualifications all count."""
    found: dict[tuple[str, str], Summary] = {}
    for one in sorted(entries, key=lambda one: one.report_id):
        found[(one.report_id if one.kind == "qualification" else one.session[0], one.kind)] = one
    return sorted(found.values(), key=lambda one: (one.measured_at, one.report_id))


def _test(test: ChartedTest) -> Json:
    first, last = test.reports[0], test.reports[-1]
    is_qualification = first.kind == "qualification"
    return {
        "test": test.number,
        "test_kind": first.kind,
        "source": None if is_qualification else first.source,
        "camera_name": (first.source or None) if is_qualification else None,
        "pose_count": len(poses_in(first.poses)),
        **first.conditions,
        "sessions": len(test.reports),
        "first_measured_at": first.measured_at,
        "last_measured_at": last.measured_at,
        "charted": bool(test.charts),
        "sessions_between_false_alarms": SESSIONS_BETWEEN_FALSE_ALARMS if test.charts else None,
    }


def _figure(test: ChartedTest, key: Key, series: Series) -> Json:
    chart = test.charts.get(key)
    last = series[-1]
    return {
        "test": test.number,
        "of": key[0],
        "figure": key[1],
        "unit": last[1].unit,
        "sessions": len(series),
        "first": series[0][1].value,
        "last": last[1].value,
        "last_session_id": last[0].session[0],
        "last_deviation": last[1].deviation,
        "limits": None
        if chart is None
        else {
            "centre": chart.limits.centre,
            "low": chart.limits.lower,
            "high": chart.limits.upper,
            "ewma_limit": chart.ewma_limit,
            "in_control": len(series) - 1 not in chart.outside and chart.alarm is None,
        },
        "alarm": None if chart is None else _alarm(chart, series, test.sentences.get(key, "")),
    }


def _alarm(chart: ControlChart, series: Series, sentence: str) -> Json | None:
    if chart.alarm is None:
        return None
    since, shown = (series[place][0] for place in (chart.alarm.since, chart.alarm.at))
    return {
        "direction": chart.alarm.direction,
        "before": chart.alarm.before,
        "after": chart.alarm.after,
        "since_session_id": since.session[0],
        "since": since.measured_at,
        "shown_by_session_id": shown.session[0],
        "shown_at": shown.measured_at,
        "sentence": sentence,
    }


def _session_figures(test: int, key: Key, series: Series, chart: ControlChart | None) -> Iterator[Json]:
    outside = frozenset() if chart is None else frozenset(chart.outside)
    alarm = None if chart is None else chart.alarm
    marks = {} if alarm is None else {alarm.since: "since", alarm.at: "shown"}
    scores = [None] * len(series) if chart is None else [_finite(value) for value in chart.ewma.tolist()]
    for place, (report, figure) in enumerate(series):
        low, high = figure.interval if figure.interval is not None else (None, None)
        yield {
            "test": test,
            "of": key[0],
            "figure": key[1],
            "measured_at": report.measured_at,
            "session_id": report.session[0],
            "session_name": report.session[1],
            "report_id": None if report.kind == "qualification" else report.report_id,
            "qualification_id": report.report_id if report.kind == "qualification" else None,
            "value": figure.value,
            "low": low,
            "high": high,
            "unit": figure.unit,
            "deviation": figure.deviation,
            "ewma": scores[place],
            "outside": place in outside,
            "alarm_mark": marks.get(place),
        }


def _finite(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None
