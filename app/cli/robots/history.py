"""`gridpose robots history`: a robot's figures over its sessions, with control charts of those that are comparable."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from app.cli.console import OptionRefused, error_console, output_console, print_list
from app.cli.options.access import ReadAccess
from app.cli.reports.figures import FiledReport, read_filed
from app.cli.robots.history_charts import (
    MIN_SESSIONS,
    Charts,
    Event,
    alarm_sentences,
    chart_tests,
    group_comparable,
    read_events,
    series_of,
    unit_of,
)
from app.client import ServiceClient, find_robot
from app.reports.control_chart import ChartedFigure, control_chart_svg

_KINDS = ("repeatability", "kinematics", "camera")
_COLUMNS = (
    "measured_at",
    "session_id",
    "session",
    "report",
    "test",
    "of",
    "figure",
    "value",
    "unit",
    "alarm",
)
Tests = Sequence[Sequence[FiledReport]]


def history(
    robot: Annotated[str, typer.Argument(help="Id or name of the robot.")],
    service: ReadAccess,
    table: Annotated[
        Path | None,
        typer.Option("--csv", help="Write every figure of every session to this file.", dir_okay=False),
    ] = None,
    drawing: Annotated[
        Path | None, typer.Option("--svg", help="Draw the control charts to this file.", dir_okay=False)
    ] = None,
    events: Annotated[
        Path | None,
        typer.Option(
            help="Maintenance: a CSV file with the columns at, note, restarts (yes where charts begin anew).",
            dir_okay=False,
        ),
    ] = None,
) -> int:
    """Show RP, AP, noise floor, parameters and cameras of a robot over its reports, and what changed lastingly.

    Each session counts by its latest report of a kind. Only sessions of the same commanded poses, load, speed and
    temperature (within 2 K) share a control chart. Ends with 1 where a chart shows a lasting change.
    """
    alarms: list[str] = []

    def act(client: ServiceClient) -> None:
        noted = read_events(events) if events is not None else []
        found = find_robot(client, robot)
        tests = group_comparable(_latest(client, found["id"]), noted)
        if not tests:
            raise OptionRefused(
                "There is no report of a session of this robot.",
                "Make one of each session: `gridpose report create SESSION --kind repeatability`.",
            )
        charts = chart_tests(tests)
        for number, (test, of_test) in enumerate(zip(tests, charts, strict=True), start=1):
            _print_test(number, test, of_test)
            alarms.extend(alarm_sentences(test, of_test, noted))
        for sentence in alarms:
            output_console().print(escape(sentence))
        if table is not None:
            _write(table, tests, charts)
        if drawing is not None:
            _draw(drawing, tests, charts, noted, found["name"])

    ended = service.run(act)
    return ended or int(bool(alarms))


def _latest(client: ServiceClient, robot_id: str) -> list[FiledReport]:
    """Return the latest report of each kind of each of the robot's sessions, by the time of measurement."""
    found: dict[tuple[str, str], FiledReport] = {}
    for one in client.items("/v1/reports"):
        if one["status"] != "succeeded" or one["kind"] not in _KINDS:
            continue
        filed = read_filed(client.get_bytes(f"/v1/reports/{one['id']}.json"), one["id"])
        if filed.robot_id == robot_id:
            found[(filed.session[0], filed.kind)] = filed
    return sorted(found.values(), key=lambda filed: (filed.measured_at, filed.report_id))


def _print_test(number: int, test: Sequence[FiledReport], charts: Charts) -> None:
    first = test[0]
    print(f"Test {number}: {first.kind}, {len(test)} comparable sessions, from {first.measured_at}")
    rows = []
    for (of, name), series in series_of(test).items():
        values = [value for _, value in series]
        chart = charts.get((of, name))
        limits = "" if chart is None else f"{chart.limits.lower:.4g} to {chart.limits.upper:.4g}"
        outside = "" if chart is None else ", ".join(series[k][0].session[1] for k in chart.outside)
        rows.append((of, name, str(len(values)), f"{values[0]:.6g}", f"{values[-1]:.6g}", limits, outside))
    print_list(
        ("of", "figure", "sessions", "first", "last", "three-sigma limits", "outside"), rows, "No figures."
    )
    if len(test) < MIN_SESSIONS:
        error_console().print(
            f"[yellow]No chart: {len(test)} sessions are comparable, and a chart takes {MIN_SESSIONS}.[/]"
        )


def _write(path: Path, tests: Tests, charts: Sequence[Charts]) -> None:
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(_COLUMNS)
            for number, (test, of_test) in enumerate(zip(tests, charts, strict=True), start=1):
                for key, series in series_of(test).items():
                    alarm = of_test[key].alarm if key in of_test else None
                    marks = {} if alarm is None else {alarm.since: "since", alarm.at: "shown"}
                    for place, (report, value) in enumerate(series):
                        session_id, name = report.session
                        about = (report.measured_at, session_id, _guarded(name), report.report_id, number)
                        rows.writerow((*about, *key, repr(value), unit_of(series, key), marks.get(place, "")))
    except OSError as error:
        raise OptionRefused(f"{path} cannot be written: {error.strerror}.") from error


def _guarded(text: str) -> str:
    """Return a text that spreadsheets do not take for a formula."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text


def _draw(path: Path, tests: Tests, charts: Sequence[Charts], events: Sequence[Event], robot: str) -> None:
    figures = []
    for number, (test, of_test) in enumerate(zip(tests, charts, strict=True), start=1):
        sentences = dict(zip(_alarming(of_test), alarm_sentences(test, of_test), strict=True))
        for key, series in series_of(test).items():
            if key not in of_test:
                continue
            chart = of_test[key]
            times = [report.measured_at for report, _ in series]
            places = (sum(time < event.at for time in times) for event in events)
            figures.append(
                ChartedFigure(
                    name=f"{' '.join(reversed(key))}, test {number}",
                    unit=unit_of(series, key),
                    values=chart.values,
                    centre=chart.limits.centre,
                    lower=chart.limits.lower,
                    upper=chart.limits.upper,
                    outside=chart.outside,
                    ewma=chart.ewma,
                    ewma_limit=chart.ewma_limit,
                    since=chart.alarm.since if chart.alarm is not None else None,
                    at=chart.alarm.at if chart.alarm is not None else None,
                    sentence=sentences.get(key, "No lasting change is shown."),
                    events=tuple(place for place in places if 0 < place < len(series)),
                )
            )
    if not figures:
        raise OptionRefused(
            "There is no chart to draw.", f"A chart takes {MIN_SESSIONS} sessions that are comparable."
        )
    try:
        path.write_bytes(control_chart_svg(figures, f"History of {robot}"))
    except OSError as error:
        raise OptionRefused(f"{path} cannot be written: {error.strerror}.") from error


def _alarming(charts: Charts) -> list[tuple[str, str]]:
    """Return the series whose charts have an alarm, in the order of their sentences."""
    return [key for key, chart in charts.items() if chart.alarm is not None]
