"""A robot's history read from what is stored; summaries taken from reports that have none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import orm

from app.analyses.history.charting import HistoryEvent
from app.analyses.history.over_time import (
    ChartedTest,
    as_text,
    charted_tests,
    entries_of_qualifications,
    history_document,
)
from app.analyses.history.summaries import NotAReport, Summary, read_report, read_summary, summary_of
from app.errors import RowUnreadable
from app.records.database import Database
from app.records.readable import CODE, unreadable_columns
from app.records.tables import RobotEvent
from app.services import reports, robots
from app.services.robots import HistoryRows

KINDS = ("repeatability", "kinematics", "camera", "qualification")
_AT_ONCE = 20


@dataclass(frozen=True, slots=True)
class History:
    """A robot's history: its tests with charts, its events, and what is missing."""

    robot: dict[str, str]
    tests: Sequence[ChartedTest]
    events: Sequence[HistoryEvent]
    warnings: Sequence[dict[str, str | None]]

    def document(self) -> dict[str, Any]:
        """Return the history as the API shows it."""
        return {
            **history_document(self.robot, self.tests, self.events),
            "warnings": list(self.warnings),
        }


def read_history(database: Database, robot_id: str, kind: str | None = None) -> History:
    """Return a robot's history, of one kind or all. Raises NotFound, RowUnreadable for the robot."""
    with database.read() as records:
        rows = robots.read_history_rows(records, robot_id, KINDS if kind is None else (kind,))
    warnings = _missing(rows)
    events = []
    for row in rows.events:
        if damaged := unreadable_columns(row):
            warnings.append(_unreadable("event", row.id, damaged))
        else:
            events.append(_event(row))
    events.sort(key=lambda event: (event.at, event.event_id))
    entries: list[Summary] = []
    for report_id, stored in rows.summaries:
        try:
            entries.append(read_summary(stored))
        except NotAReport:
            warnings.append(_unreadable("report's summary", report_id, ["summary"]))
    for one in rows.qualifications:
        try:
            entries.extend(entries_of_qualifications([one]))
        except (TypeError, AttributeError, ValueError):
            warnings.append(_unreadable("qualification", one["id"], ["figures"]))
    return History(
        robot={"id": rows.robot.id, "name": rows.robot.name},
        tests=charted_tests(entries, events),
        events=events,
        warnings=warnings,
    )


def read_filed_report(records: orm.Session, report_id: str) -> Summary:
    """Return what is compared of a stored report.

    Raises NotFound, Conflict where it is not made, RowUnreadable where its JSON form is damaged or of a later version.
    """
    content, _ = reports.read_form(records, report_id, "json")
    try:
        return read_report(content)
    except NotAReport as error:
        advice = "Install the version that made it." if error.is_later else None
        raise RowUnreadable(f"report ({report_id})", ["content of json"], advice) from error


def summarise_reports(database: Database) -> int:
    """Take from some reports that have no summary yet what is compared of them; return from how many."""
    with database.read() as records:
        found = robots.reports_without_summary(records, _AT_ONCE)
    if found:
        summaries = {
            report_id: summary_or_none(None if row is None else reports.inflated(row))
            for report_id, row in found.items()
        }
        with database.write() as records:
            robots.save_summaries(records, summaries)
    return len(found)


def summary_or_none(content: bytes | None) -> dict[str, Any] | None:
    """Return what is compared of a report's JSON form; None for anything else, which histories name."""
    if content is None:
        return None
    try:
        return summary_of(content)
    except NotAReport:
        return None


def _event(row: RobotEvent) -> HistoryEvent:
    return HistoryEvent(row.id, as_text(row.at), row.note, row.restarts_charts)


def _missing(rows: HistoryRows) -> list[dict[str, str | None]]:
    found: list[dict[str, str | None]] = []
    if rows.is_truncated:
        detail = "The robot has more reports than one history shows; the earliest are missing."
        found.append(_warning(code="history_truncated", detail=detail, advice="Ask for one kind at a time."))
    if rows.unread:
        detail = f"Reports of this installation that are not read yet: {rows.unread}."
        found.append(_warning(code="history_incomplete", detail=detail, advice="Ask again shortly."))
    return found + [_unreadable("report", report_id, ["content of json"]) for report_id in rows.unreadable]


def _warning(*, code: str, detail: str, advice: str) -> dict[str, str | None]:
    return {"code": code, "detail": detail, "advice": advice}


def _unreadable(noun: str, row_id: str, columns: Sequence[str]) -> dict[str, str | None]:
    error = RowUnreadable(f"{noun} ({row_id})", columns)
    return {"code": CODE, "detail": error.detail, "advice": error.advice}
