"""The rows of one session: read from its installation, written as lines, and read again at any later schema."""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

import sqlalchemy as sa

from app.errors import RowUnreadable
from app.records.readable import unreadable_values
from app.records.tables import (
    MeasuredPose,
    Measurement,
    Pose,
    Qualification,
    Report,
    ReportForm,
    Result,
    Robot,
    RobotEvent,
    Session,
    SessionTarget,
    Table,
    Target,
)
from app.services.archive.container import damaged

Json = dict[str, Any]
_AT_ONCE = 200
MAX_LINE_BYTES = 64 * 1024 * 1024
"""Most bytes of one row: a result of 100,000 grid points has less."""
OF_SESSION: tuple[type[Table], ...] = (
    *(Robot, Target, Session, SessionTarget, Pose, Measurement, Result, MeasuredPose, Report, ReportForm),
    *(Qualification, RobotEvent),
)
"""Tables of a session's rows, parents before children."""
_OWN_FILES = {ReportForm.__tablename__: "content"}
"""Columns whose bytes are files of the archive themselves."""


def archived_rows(connection: sa.Connection, table: type[Table], session_id: str) -> Iterator[Json]:
    """Yield the rows of a table that belong to a session, by column, oldest first. Raises RowUnreadable."""
    statement = (
        sa.select(table.__table__).where(_belongs(table, session_id)).order_by(*table.__table__.primary_key)
    )
    for row in connection.execution_options(yield_per=_AT_ONCE).execute(statement):
        values = dict(row._mapping)
        unreadable = unreadable_values(table, values)
        if unreadable:
            first = next(iter(values.values()))
            raise RowUnreadable(f"row of {table.__tablename__} ({first})", unreadable)
        yield values


def encode_row(table: type[Table], row: Mapping[str, Any]) -> bytes:
    """Return a row as one line of JSON: times in ISO 8601, bytes in base64."""
    own = _OWN_FILES.get(table.__tablename__)
    document = {name: _plain(value) for name, value in row.items() if name != own}
    return json.dumps(document, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def decode_row(table: sa.TableClause, line: bytes) -> Json:
    """Return a line's values by the columns of the table, as it is in the archive's schema. Raises ArchiveRefused."""
    own = _OWN_FILES.get(table.name)
    try:
        document = json.loads(line)
        if not isinstance(document, dict) or set(document) != {*table.c.keys()} - {own}:
            raise damaged(f"a row of {table.name} has other columns than its schema")
        row = {name: _stored(table.c[name].type, value) for name, value in document.items()}
    except (ValueError, TypeError, RecursionError, binascii.Error) as error:
        raise damaged(f"a row of {table.name} cannot be read") from error
    return row if own is None else {**row, own: b""}


def _belongs(table: type[Table], session_id: str) -> sa.ColumnElement[bool]:
    """Return which rows of a table a session's archive holds; of its reports, those that are made."""
    made = sa.and_(Report.session_id == session_id, Report.status == "succeeded")
    robot = sa.select(Session.robot_id).where(Session.id == session_id)
    of_session = {
        Robot: Robot.id.in_(robot),
        RobotEvent: RobotEvent.robot_id.in_(robot),
        # Those that measurements name are there as well, though the session may look at others now.
        Target: sa.or_(
            Target.id.in_(sa.select(SessionTarget.target_id).where(SessionTarget.session_id == session_id)),
            Target.id.in_(sa.select(Measurement.target_id).where(Measurement.session_id == session_id)),
            Target.id.in_(
                sa.select(Measurement.stated_target_id).where(Measurement.session_id == session_id)
            ),
        ),
        Session: Session.id == session_id,
        Result: Result.measurement_id.in_(
            sa.select(Measurement.id).where(Measurement.session_id == session_id)
        ),
        Report: made,
        ReportForm: ReportForm.report_id.in_(sa.select(Report.id).where(made)),
    }
    if table in of_session:
        return of_session[table]
    return table.__table__.c.session_id == session_id


def _plain(value: Any) -> Any:
    if isinstance(value, bytes | memoryview):
        return base64.b64encode(value).decode()
    return value.isoformat() if isinstance(value, datetime) else value


def _stored(kind: sa.types.TypeEngine[Any], value: Any) -> Any:
    if value is None:
        return None
    if isinstance(kind, sa.LargeBinary):
        return base64.b64decode(value, validate=True)
    return datetime.fromisoformat(value) if _is_time(kind) else value


def _is_time(kind: sa.types.TypeEngine[Any]) -> bool:
    return isinstance(kind, sa.types.TypeDecorator) and isinstance(kind.impl_instance, sa.DateTime)
