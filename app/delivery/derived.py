"""What a notice leads to: verdicts that a new report changed, and alarms in its robot's history."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.analyses.history import NotAReport, read_history, read_report, unlike
from app.errors import ServiceError
from app.records.database import Database
from app.records.tables import Notice, Report, ReportSummary
from app.services import reports

_LOOKED_AT = 5
"""Earlier reports of the robot that are looked at for one that is comparable."""


@dataclass(frozen=True, slots=True)
class Derived:
    """A notice to be written; `about` makes it one that is written once."""

    type: str
    data: dict[str, Any]
    about: tuple[str, ...]


def derived_of(database: Database, notice: Notice) -> list[Derived]:
    """Return what follows from a notice; nothing where a report cannot be read."""
    if notice.type not in ("report.ready", "qualification.made"):
        return []
    found: list[Derived] = []
    if notice.data.get("kind") == "repeatability":
        found += _verdicts(database, notice.data)
    robot_id = notice.data.get("robot_id")
    if robot_id is not None:
        found += _alarms(database, robot_id)
    return found


def _alarms(database: Database, robot_id: str) -> Iterator[Derived]:
    try:
        history = read_history(database, robot_id)
    except ServiceError:
        return
    for test in history.tests:
        for (of, figure), chart in test.charts.items():
            alarm = chart.alarm
            if alarm is None:
                continue
            series = test.series[of, figure]
            since, shown = series[alarm.since][0], series[alarm.at][0]
            yield Derived(
                "robot.alarm",
                {
                    "robot_id": robot_id,
                    "robot_name": history.robot["name"],
                    "of": of,
                    "figure": figure,
                    "direction": alarm.direction,
                    "since_session_id": since.session[0],
                    "since": since.measured_at,
                    "shown_by_session_id": shown.session[0],
                    "sentence": test.sentences.get((of, figure), ""),
                },
                (robot_id, since.kind, of, figure, since.report_id),
            )


def _verdicts(database: Database, data: Mapping[str, Any]) -> Iterator[Derived]:
    """Yield the change of verdicts from the report before it that is comparable."""
    report_id = data["report_id"]
    try:
        with database.read() as records:
            content, _ = reports.read_form(records, report_id, "json")
            new = read_report(content)
            for earlier_id in _earlier(records, report_id, new.robot_id, new.session[0]):
                earlier, _ = reports.read_form(records, earlier_id, "json")
                if not unlike(read_report(earlier), new):
                    break
            else:
                return
    except (ServiceError, NotAReport):
        return
    before, after = verdicts_of(earlier), verdicts_of(content)
    changes = [
        {"of": of, "before": before[of], "after": after[of]}
        for of in after
        if of in before and before[of] != after[of]
    ]
    if changes:
        about = {name: data[name] for name in ("session_id", "session_name", "robot_id")}
        stated = {"report_id": report_id, "earlier_report_id": earlier_id, **about, "changes": changes}
        yield Derived("verdict.changed", stated, (report_id,))


def _earlier(records: orm.Session, report_id: str, robot_id: str | None, session_id: str) -> list[str]:
    """Return the latest earlier reports on repeatability of the same robot, or without one of the same session."""
    same = Report.session_id == session_id if robot_id is None else ReportSummary.robot_id == robot_id
    return list(
        records.scalars(
            sa.select(Report.id)
            .join(ReportSummary, ReportSummary.report_id == Report.id)
            .where(same, Report.kind == "repeatability", Report.status == "succeeded", Report.id < report_id)
            .order_by(Report.id.desc())
            .limit(_LOOKED_AT)
        )
    )


def verdicts_of(content: bytes) -> dict[str, str]:
    """Return the verdict of each pose of a repeatability report's JSON form, and what it decides on the data sheet."""
    found = json.loads(content)["analyses"]["repeatability"]
    stated = {f"pose {pose['pose_id']}": pose.get("verdict") for pose in found["poses"]}
    for name in ("acceptance", "accuracy_acceptance"):
        stated[name] = (found.get(name) or {}).get("decision")
    return {of: verdict for of, verdict in stated.items() if isinstance(verdict, str)}
