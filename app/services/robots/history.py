"""What is stored of a robot over time: summaries of its sessions' reports, qualifications, events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.tables import Qualification, Report, ReportForm, ReportSummary, Robot, RobotEvent, Session
from app.services.queries import get_or_raise, require_readable, visible
from app.services.robots.events import events_of

MAX_REPORTS = 3000
"""Reports and, of their own, qualifications of one history: the latest."""
_QUALIFICATION = (
    *("id", "session_id", "session_name", "robot_id", "camera_name", "made_at"),
    *("worst_error_mm", "scale_ppm", "probing_scatter_mm"),
)


@dataclass(frozen=True, slots=True)
class HistoryRows:
    """What a robot's history is made of, all of one moment.

    `summaries` are stored ones by their reports' ids; `is_truncated` where there are earlier ones that are missing.
    `unread` reports have no summary yet, of whatever robot; `unreadable` ones of the robot's sessions never have.
    """

    robot: Robot
    summaries: Sequence[tuple[str, Any]]
    qualifications: Sequence[Mapping[str, Any]]
    events: Sequence[RobotEvent]
    is_truncated: bool
    unread: int
    unreadable: Sequence[str]


def read_history_rows(records: orm.Session, robot_id: str, kinds: Sequence[str]) -> HistoryRows:
    """Return what a history of these kinds, `qualification` among them or not, is made of.

    Raises NotFound, RowUnreadable for the robot.
    """
    robot = get_or_raise(records, Robot, robot_id)
    require_readable(robot)
    of_kinds = (Report.kind.in_(kinds), Report.status == "succeeded", *visible(Report))
    joined = sa.select(ReportSummary.report_id, ReportSummary.summary).join(
        Report, Report.id == ReportSummary.report_id
    )
    rows = records.execute(
        joined.where(ReportSummary.robot_id == robot_id, *of_kinds)
        .order_by(ReportSummary.report_id.desc())
        .limit(MAX_REPORTS + 1)
    ).all()
    qualifications: Sequence[sa.Row[Any]] = ()
    if "qualification" in kinds:
        qualifications = records.execute(
            sa.select(*(getattr(Qualification, name) for name in _QUALIFICATION))
            .where(Qualification.robot_id == robot_id, *visible(Qualification))
            .order_by(Qualification.id.desc())
            .limit(MAX_REPORTS + 1)
        ).all()
    unreadable = records.scalars(
        sa.select(Report.id)
        .join(ReportSummary, ReportSummary.report_id == Report.id)
        .join(Session, Session.id == Report.session_id)
        .where(Session.robot_id == robot_id, ReportSummary.summary.is_(None), *of_kinds)
        .order_by(Report.id)
    ).all()
    return HistoryRows(
        robot=robot,
        summaries=[(row.report_id, row.summary) for row in reversed(rows[:MAX_REPORTS])],
        qualifications=[row._asdict() for row in reversed(qualifications[:MAX_REPORTS])],
        events=events_of(records, robot_id),
        is_truncated=max(len(rows), len(qualifications)) > MAX_REPORTS,
        unread=records.scalar(sa.select(sa.func.count()).select_from(Report).where(_without_summary())) or 0,
        unreadable=unreadable,
    )


def latest_reports(records: orm.Session, limit: int) -> dict[str, tuple[str, str]]:
    """Return each robot's latest report on repeatability and the robot's name, by the robot's id; the latest first."""
    latest = sa.func.max(ReportSummary.report_id)
    rows = records.execute(
        sa.select(ReportSummary.robot_id, latest, Robot.name)
        .join(Report, Report.id == ReportSummary.report_id)
        .join(Robot, Robot.id == ReportSummary.robot_id)
        .where(Report.kind == "repeatability", Report.status == "succeeded")
        .group_by(ReportSummary.robot_id, Robot.name)
        .order_by(latest.desc())
        .limit(limit)
    )
    return {str(robot_id): (report_id, str(name)) for robot_id, report_id, name in rows}


def reports_without_summary(records: orm.Session, limit: int) -> dict[str, Any]:
    """Return made reports that have no summary yet with their JSON forms (content, sha256); None without one."""
    ids = records.scalars(
        sa.select(Report.id).where(_without_summary()).order_by(Report.id).limit(limit)
    ).all()
    columns = (ReportForm.report_id, ReportForm.content, ReportForm.sha256)
    forms = records.execute(
        sa.select(*columns).where(ReportForm.report_id.in_(ids), ReportForm.form == "json")
    )
    found: dict[str, Any] = dict.fromkeys(ids)
    for row in forms:
        found[row.report_id] = row
    return found


def save_summaries(records: orm.Session, summaries: Mapping[str, dict[str, Any] | None]) -> None:
    """Store what is compared of reports, by their ids; what another process stored meanwhile stays."""
    there = set(
        records.scalars(
            sa.select(ReportSummary.report_id).where(ReportSummary.report_id.in_(list(summaries)))
        )
    )
    for report_id, summary in summaries.items():
        if report_id not in there:
            robot_id = None if summary is None else summary["robot_id"]
            records.add(ReportSummary(report_id=report_id, robot_id=robot_id, summary=summary))


def _without_summary() -> sa.ColumnElement[bool]:
    return sa.and_(
        Report.status == "succeeded",
        ~sa.exists().where(ReportSummary.report_id == Report.id),
    )
