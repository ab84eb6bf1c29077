"""Qualifications: stored once, listed, cited by what is measured after them, and compared with the earlier ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.activity import maker_name, note_objects
from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import Qualification, Session
from app.services.notices import note
from app.services.queries import get_or_raise, require_readable, visible

MAX_EARLIER = 100
"""Of the earlier qualifications the last ones, from which control limits are."""
CHARTED = ("worst_error_mm", "scale_ppm", "probing_scatter_mm")
"""Figures that have a control chart."""


@dataclass(frozen=True, slots=True)
class QualificationDetail:
    """A qualification, and the figures of the earlier ones of the same robot and camera, oldest first, by name."""

    row: Qualification
    earlier: Mapping[str, list[float]]


def store_qualification(
    records: orm.Session,
    session_id: str,
    analysis: Mapping[str, Any],
    *,
    valid_days: int,
    camera_name: str | None,
) -> QualificationDetail:
    """Store what an analysis by known lengths found of a session's set-up. Raises NotFound, RowUnreadable."""
    session = get_or_raise(records, Session, session_id)
    require_readable(session)
    made = datetime.now(UTC)
    row = Qualification(
        id=new_id("qua"),
        session_id=session_id,
        session_name=session.name,
        robot_id=session.robot_id,
        camera_name=camera_name,
        made_at=made,
        due_at=made + timedelta(days=valid_days),
        analysis=dict(analysis),
        made_by_name=maker_name(),
        **{name: analysis[name] for name in (*CHARTED, "decision", "maximum_permissible_error_mm")},
    )
    records.add(row)
    note_objects([row.id])
    records.flush()
    note(
        records,
        "qualification.made",
        {
            "qualification_id": row.id,
            "session_id": session_id,
            "session_name": session.name,
            "robot_id": session.robot_id,
            "decision": row.decision,
            "due_at": row.due_at.isoformat(timespec="seconds").replace("+00:00", "Z"),
        },
    )
    return _detail(records, row)


def get_qualification(records: orm.Session, qualification_id: str) -> QualificationDetail:
    """Return a qualification with the figures of the earlier ones. Raises NotFound, RowUnreadable."""
    row = get_or_raise(records, Qualification, qualification_id)
    require_readable(row)
    return _detail(records, row)


def list_qualifications(
    records: orm.Session, *, robot_id: str | None, limit: int, cursor: str | None
) -> tuple[Sequence[Qualification], str | None]:
    """Return one page of qualifications, oldest first: of one robot, or all."""
    statement = sa.select(Qualification).where(*visible(Qualification))
    if robot_id is not None:
        statement = statement.where(Qualification.robot_id == robot_id)
    return page(records, statement, Qualification.id, limit=limit, cursor=cursor)


def latest_qualification_ids(records: orm.Session, robot_id: str | None) -> list[str | None]:
    """Return the ids of the latest records of the robot and of the installation: they change with what is cited."""
    return [
        records.scalar(sa.select(sa.func.max(Qualification.id)).where(_of_robot(one)))
        for one in dict.fromkeys((robot_id, None))
    ]


def _of_robot(robot_id: str | None) -> sa.ColumnElement[bool]:
    return Qualification.robot_id.is_(None) if robot_id is None else Qualification.robot_id == robot_id


def latest_qualification(records: orm.Session, robot_id: str | None, source: str) -> Mapping[str, Any] | None:
    """Return what analyses and reports cite: the latest of the robot, or else of the installation; None for none.

    It is of the same `source`: what images of known lengths showed says nothing of another instrument.
    """
    columns = (Qualification.id, Qualification.made_at, Qualification.due_at, Qualification.decision)
    for of_robot in dict.fromkeys((robot_id, None)):
        rows = records.execute(
            sa.select(*columns, Qualification.analysis)
            .where(_of_robot(of_robot))
            .order_by(Qualification.id.desc())
        ).yield_per(5)
        for *values, analysis in rows:
            # One that cannot be read says nothing of any source.
            if isinstance(analysis, dict) and analysis.get("source") == source:
                rows.close()
                return {column.key: value for column, value in zip(columns, values, strict=True)}
    return None


def _detail(records: orm.Session, row: Qualification) -> QualificationDetail:
    columns = [getattr(Qualification, name) for name in CHARTED]
    same = [
        column.is_(None) if value is None else column == value
        for column, value in (
            (Qualification.robot_id, row.robot_id),
            (Qualification.camera_name, row.camera_name),
        )
    ]
    earlier = records.execute(
        sa.select(*columns)
        .where(*same, Qualification.id < row.id)
        .order_by(Qualification.id.desc())
        .limit(MAX_EARLIER)
    ).all()
    return QualificationDetail(
        row,
        {
            name: [one[place] for one in reversed(earlier) if isinstance(one[place], float)]
            for place, name in enumerate(CHARTED)
        },
    )
