"""A robot's reports as tests of sessions that are comparable, their figures as series, and the charts of these."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from app.cli.console import OptionRefused
from app.cli.reports.figures import FiledReport, unlike
from core.metrology import ControlChart, chart_figure

MIN_SESSIONS = 5
"""Sessions that are comparable, below which no chart is drawn."""
SESSIONS_BETWEEN_FALSE_ALARMS = 370.0
Key = tuple[str, str]
Series = dict[Key, list[tuple[FiledReport, float]]]
Charts = dict[Key, ControlChart]


@dataclass(frozen=True, slots=True)
class Event:
    """Something done to the robot; `restarts` where figures before and after it are not to be compared."""

    at: str
    note: str
    restarts: bool


def read_events(path: Path) -> list[Event]:
    """Return the events of a CSV file with the columns at, note and restarts (yes or no), by time.

    Raises OptionRefused.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file))
        events = [
            Event(
                _time(row["at"]), row["note"].strip(), _IS_YES[(row.get("restarts") or "no").strip().lower()]
            )
            for row in rows
        ]
    except (OSError, KeyError, ValueError, TypeError, csv.Error) as error:
        raise OptionRefused(
            f"{path} is no list of events.",
            "Its columns are at (2026-05-31 or 2026-05-31T14:00:00Z), note, and restarts (yes or no).",
        ) from error
    return sorted(events, key=lambda event: event.at)


_IS_YES = {"yes": True, "no": False, "": False}


def _time(text: str) -> str:
    """Return a time as reports state it, so that texts are in the order of times."""
    moment = datetime.fromisoformat(text.strip())
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    return moment.isoformat().replace("+00:00", "Z")


def group_comparable(reports: Sequence[FiledReport], events: Sequence[Event] = ()) -> list[list[FiledReport]]:
    """Return reports by tests: those of one test are comparable with its first, with no restart in between."""
    tests: list[list[FiledReport]] = []
    restarts = [event.at for event in events if event.restarts]

    def epoch(report: FiledReport) -> int:
        return sum(at <= report.measured_at for at in restarts)

    for report in reports:
        test = next(
            (test for test in tests if epoch(test[0]) == epoch(report) and not unlike(test[0], report)), None
        )
        if test is None:
            tests.append([report])
        else:
            test.append(report)
    return tests


def series_of(test: Sequence[FiledReport]) -> Series:
    """Return the figures of a test over its sessions: of poses their geometric mean, since the poses are the same."""
    found: Series = {}
    for report in test:
        of_poses: dict[str, list[float]] = {}
        for (of, name), figure in report.figures.items():
            if figure.is_length and figure.value > 0.0:
                of_poses.setdefault(name, []).append(math.log(figure.value))
            elif not figure.is_length:
                found.setdefault((of, name), []).append((report, figure.value))
        for name, logs in of_poses.items():
            found.setdefault(("all poses", name), []).append((report, math.exp(float(np.mean(logs)))))
    return found


def unit_of(series: Sequence[tuple[FiledReport, float]], key: Key) -> str:
    """Return the unit of a series."""
    return next(figure.unit for (_, name), figure in series[0][0].figures.items() if name == key[1])


def chart_tests(tests: Sequence[Sequence[FiledReport]]) -> list[Charts]:
    """Return the charts of each test's series that are long enough; those of a test share its rate of false alarms."""
    enough = [
        {key: series for key, series in series_of(test).items() if len(series) >= MIN_SESSIONS}
        for test in tests
    ]
    return [
        {
            key: chart_figure(
                [value for _, value in series],
                logarithms=key[0] == "all poses",
                run_length=SESSIONS_BETWEEN_FALSE_ALARMS * len(found),
            )
            for key, series in found.items()
        }
        for found in enough
    ]


def alarm_sentences(
    test: Sequence[FiledReport], charts: Charts, events: Sequence[Event] = ()
) -> Iterator[str]:
    """Yield what changed lastingly, since when, by how much, and what was done to the robot at that time."""
    for key, series in series_of(test).items():
        chart = charts.get(key)
        if chart is None or chart.alarm is None:
            continue
        alarm = chart.alarm
        last, since, at = (series[k][0] for k in (alarm.since - 1, alarm.since, alarm.at))
        sentence = (
            f"{' '.join(reversed(key))} went {alarm.direction}, from {alarm.before:.6g} to {alarm.after:.6g}, "
            f"since the session {since.session[1]} ({since.measured_at}); shown by {at.session[1]} ({at.measured_at})."
        )
        between = [event for event in events if last.measured_at < event.at <= since.measured_at]
        if between:
            sentence += f" Before it: {'; '.join(f'{event.note} ({event.at})' for event in between)}."
        yield sentence
