"""A session's mark: it changes with whatever an analysis of the session is computed from, and costs little to ask for.

The hash of the inputs (`snapshot`) is the same in any session of any installation and takes thousands of rows; the mark
holds for one session only and is put together by the database. The rows of measurements change in their status, their
attempts and the time they were finished alone, and measured poses never, so that these stand for the rest.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.sql.elements import ColumnElement

from app.records.tables import MeasuredPose, Measurement, Pose, Robot, Session, Table
from app.services.lookup import find

_MEASUREMENT = (Measurement.id, Measurement.status, Measurement.attempts, Measurement.finished_at)
_POSE = (
    Pose.pose_id,
    Pose.position_mm,
    Pose.roll_deg,
    Pose.pitch_deg,
    Pose.yaw_deg,
    Pose.joint_angles_deg,
    Pose.approach,
)
_MEASURED_POSE = (MeasuredPose.id, MeasuredPose.content_sha256)


def read_mark(records: orm.Session, session_id: str) -> str:
    """Return the mark of a session as it is now.

    Raises NotFound.
    """
    session = find(records, Session, session_id)
    robot = records.get(Robot, session.robot_id) if session.robot_id is not None else None
    parts = [
        session_id,
        [target.target_id for target in session.targets],
        session.lens,
        session.intrinsics,
        robot.joints if robot is not None else None,
        records.scalar(_all(_MEASUREMENT, Measurement, session_id)),
        # Numbers as numbers: as text SQLite rounds them.
        [list(row) for row in records.execute(sa.select(*_POSE).where(Pose.session_id == session_id))],
        records.scalar(_all(_MEASURED_POSE, MeasuredPose, session_id)),
    ]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _all(
    columns: tuple[orm.attributes.InstrumentedAttribute[object], ...], table: type[Table], session_id: str
) -> sa.Select[Any]:
    """Select the columns of all the session's rows as one text.

    Its order is the database's: another one would only cost what the mark is there to save.
    """
    fields: list[ColumnElement[str]] = []
    for column in columns:
        # A text that begins with a letter is told from one that is missing.
        fields.append(sa.func.coalesce(sa.literal("v") + sa.cast(column, sa.Text), sa.literal("-")))
    row = fields[0]
    for field in fields[1:]:
        row = row + sa.literal("\x1f") + field
    of_session = table.__table__.c.session_id
    return sa.select(sa.func.aggregate_strings(row, "\x1e")).where(of_session == session_id)
