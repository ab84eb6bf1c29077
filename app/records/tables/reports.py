"""Tables of stored reports and their forms."""

from __future__ import annotations

import builtins
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.records.tables.base import Bytes, JsonList, JsonObject, Table, made_by_column


class Report(Table):
    """A report of a session, queued, being made, made or failed. Triggers refuse to change one that is made.

    It outlives its session, which it names without a reference: what was filed stays readable. `made_by_name` is the
    key's name at the time; `signature` is the signed manifest (`app.reports.signature`).
    """

    __tablename__ = "reports"
    __table_args__ = (
        sa.CheckConstraint("status IN ('queued', 'running', 'succeeded', 'failed')", name="status"),
        sa.Index("ix_reports_session_id_id", "session_id", "id"),
        sa.Index("ix_reports_status_id", "status", "id"),
    )

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    session_id: Mapped[str] = mapped_column(sa.String(40))
    kind: Mapped[str] = mapped_column(sa.String(32))
    title: Mapped[str] = mapped_column(sa.String(200))
    signatories: Mapped[JsonList] = mapped_column(sa.JSON())
    paper: Mapped[str] = mapped_column(sa.String(16))
    status: Mapped[str] = mapped_column(sa.String(16))
    attempts: Mapped[int]
    failure: Mapped[JsonObject | None]
    created_at: Mapped[datetime]
    claimed_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    made_by: Mapped[str | None] = made_by_column()
    made_by_name: Mapped[str | None] = mapped_column(sa.String(200))
    core_version: Mapped[str | None] = mapped_column(sa.String(64))
    inputs_sha256: Mapped[str | None] = mapped_column(sa.String(64))
    signature: Mapped[JsonObject | None]


class ReportForm(Table):
    """One form of a report. `content` is its bytes, deflated (zlib); `sha256` and `bytes` are of the inflated ones."""

    __tablename__ = "report_forms"

    report_id: Mapped[str] = mapped_column(sa.ForeignKey("reports.id"), primary_key=True)
    form: Mapped[str] = mapped_column(sa.String(16), primary_key=True)
    content: Mapped[builtins.bytes] = mapped_column(Bytes(), deferred=True)
    sha256: Mapped[str] = mapped_column(sa.String(64))
    bytes: Mapped[int] = mapped_column(sa.BigInteger())


class ReportSummary(Table):
    """What is compared of a report, taken from its JSON form (`app.analyses.history`); it can be made again any time.

    `robot_id` is the robot that the report states; `summary` null where its form cannot be read.
    """

    __tablename__ = "report_summaries"
    __table_args__ = (sa.Index("ix_report_summaries_robot_id_report_id", "robot_id", "report_id"),)

    report_id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    robot_id: Mapped[str | None] = mapped_column(sa.String(40))
    summary: Mapped[JsonObject | None]
