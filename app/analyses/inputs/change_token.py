"""A session's change token: a cheap hash that changes with everything that an analysis of the session is computed from.

The hash of the inputs (`snapshot`) is the same for equal sessions of any installation and reads thousands of rows. The
change token is valid for one session only, and the database computes it. Arrays enter it by their hash
(`content_sha256`).
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.sql.elements import ColumnElement

from app.analyses.inputs.stored_rows import POSE_COLUMNS
from app.records.tables import (
    MeasuredPose,
    Measurement,
    Pose,
    Result,
    Robot,
    Session,
    Table,
    Target,
    measured_target_fields,
)
from app.services.qualifications import latest_qualification_ids
from app.services.queries import get_or_raise

_MEASUREMENT = (
    Measurement.id,
    Measurement.pose_id,
    Measurement.cycle,
    Measurement.burst,
    Measurement.target_id,
    Measurement.focus_group,
    Measurement.joint_angles_deg,
    Measurement.status,
    Measurement.attempts,
    Measurement.finished_at,
    Measurement.excluded,
    Result.content_sha256,
)
_MEASURED_POSE = (MeasuredPose.id, MeasuredPose.content_sha256)


def read_change_token(records: orm.Session, session_id: str) -> str:
    """Return the change token of a session as it is now.

    Raises NotFound.
    """
    session = get_or_raise(records, Session, session_id)
    robot = records.get(Robot, session.robot_id) if session.robot_id is not None else None
    target_ids = [target.target_id for target in session.targets]
    targets = {row.id: row for row in records.scalars(sa.select(Target).where(Target.id.in_(target_ids)))}
    parts = [
        session_id,
        session.name,
        [
            [one, targets[one].name, measured_target_fields(targets[one], session.conditions)]
            for one in target_ids
        ],
        session.lens,
        session.intrinsics,
        session.conditions,
        session.camera_mount,
        [
            robot.id,
            robot.name,
            robot.joints,
            robot.joint_coupling,
            robot.datasheet_repeatability_mm,
            robot.datasheet_accuracy_mm,
        ]
        if robot is not None
        else None,
        latest_qualification_ids(records, session.robot_id),
        # Numbers as numbers: as text SQLite rounds them.
        [list(row) for row in records.execute(sa.select(*POSE_COLUMNS).where(Pose.session_id == session_id))],
    ]
    measurements = _all(_MEASUREMENT, Measurement, session_id).outerjoin(
        Result,
        # A hash is never empty. Saying so makes SQLite read it from the index alone, a tenth of the time that the
        # rows with their arrays take.
        sa.and_(Result.measurement_id == Measurement.id, Result.content_sha256 > ""),
    )
    digest = hashlib.sha256()
    for text in (
        json.dumps(parts, default=repr),  # an unreadable value has a text, too; its analysis is refused
        records.scalar(measurements),
        records.scalar(_all(_MEASURED_POSE, MeasuredPose, session_id)),
    ):
        digest.update(f"\x1d{text}".encode())
    return digest.hexdigest()


def _all(
    columns: tuple[orm.attributes.InstrumentedAttribute[object], ...], table: type[Table], session_id: str
) -> sa.Select[Any]:
    """Select the columns of all the session's rows as one text.

    Its order is the database's: sorting would cost the time that the change token saves.
    """
    fields: list[ColumnElement[str]] = []
    for column in columns:
        # The prefix distinguishes an empty text from a missing one.
        is_text = isinstance(column.type, sa.String)
        text: ColumnElement[str] = sa.type_coerce(column, sa.Text) if is_text else sa.cast(column, sa.Text)
        if not column.nullable and column is not Result.content_sha256:
            fields.append(text)
        else:
            fields.append(sa.func.coalesce(sa.literal("v") + text, sa.literal("-")))
    row = fields[0]
    for field in fields[1:]:
        row = row + sa.literal("\x1f") + field
    of_session = table.__table__.c.session_id
    return (
        sa.select(sa.func.aggregate_strings(row, "\x1e")).select_from(table).where(of_session == session_id)
    )
