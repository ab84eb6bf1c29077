"""What was done to a robot: notes of maintenance, which histories show and charts mark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict, NotFound
from app.records.activity import maker_name
from app.records.ids import is_id, new_id
from app.records.pagination import page
from app.records.tables import Robot, RobotEvent
from app.services.queries import get_or_raise

MAX_EVENTS = 10_000
"""Events of one robot: one a day for 27 years."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NewEvent:
    """What a client says about an event; `restarts_charts` where figures before and after are not to be compared."""

    at: datetime
    note: str
    restarts_charts: bool


def add_event(records: orm.Session, robot_id: str, new: NewEvent) -> RobotEvent:
    """Store an event of a robot. Raises NotFound, Conflict where it has too many."""
    get_or_raise(records, Robot, robot_id, lock=True)
    count = records.scalar(sa.select(sa.func.count()).where(RobotEvent.robot_id == robot_id))
    if (count or 0) >= MAX_EVENTS:
        raise Conflict(
            f"The robot has {count} events, as many as it may.",
            "Delete events that no longer matter.",
            code="too_many_events",
        )
    row = RobotEvent(
        id=new_id("eve"),
        robot_id=robot_id,
        at=new.at,
        note=new.note,
        restarts_charts=new.restarts_charts,
        created_at=datetime.now(UTC),
        made_by_name=maker_name(),
    )
    records.add(row)
    records.flush()
    return row


def list_events(
    records: orm.Session, robot_id: str, *, limit: int, cursor: str | None
) -> tuple[Sequence[RobotEvent], str | None]:
    """Return one page of a robot's events in the order in which they were noted. Raises NotFound."""
    get_or_raise(records, Robot, robot_id)
    statement = sa.select(RobotEvent).where(RobotEvent.robot_id == robot_id)
    return page(records, statement, RobotEvent.id, limit=limit, cursor=cursor)


def events_of(records: orm.Session, robot_id: str) -> Sequence[RobotEvent]:
    """Return all events of a robot in the order in which they were noted; some may not be readable."""
    return records.scalars(
        sa.select(RobotEvent).where(RobotEvent.robot_id == robot_id).order_by(RobotEvent.id)
    ).all()


def delete_event(records: orm.Session, robot_id: str, event_id: str) -> None:
    """Delete an event of a robot. Raises NotFound."""
    get_or_raise(records, Robot, robot_id)
    row = records.get(RobotEvent, event_id) if is_id(event_id) else None
    if row is None or row.robot_id != robot_id:
        raise NotFound.of("event")
    records.delete(row)
