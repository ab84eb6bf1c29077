"""Looks at a session: its counts, and which measurements changed since the last look."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.database import Database
from app.records.tables import Session
from app.services.following.changes import StatusChange, latest_position, read_changes
from app.services.following.position import Position, parse_position
from app.services.sessions import Counts, count_measurements


class Start(NamedTuple):
    """Where a follower begins, and the session's counts, which hold every change up to there."""

    position: Position
    counts: Counts


@dataclass(frozen=True, slots=True)
class Look:
    """What one look at a session found."""

    position: Position
    """Where the next look goes on."""
    changes: list[StatusChange]
    are_all: bool
    """Whether no other change was there, nor one that is not final yet."""
    counts: Counts | None
    """The session's counts, None where they were not read."""

    @property
    def has_more(self) -> bool:
        """Whether the next look should follow at once."""
        return bool(self.changes) and not self.are_all


def start(database: Database, session_id: str, last_seen: str | None) -> Start | None:
    """Return where a follower begins; None where there is no such session.

    `last_seen` is the text of the position that it had. Without one, or with one that is no position, it begins after
    all changes that there are. So it does with one that is later, as after a restored backup.
    """
    with database.read() as records:
        if not _exists(records, session_id):
            return None
        position = latest_position(records, session_id)  # before the counts: what changes meanwhile follows
        seen = parse_position(last_seen) if last_seen else None
        if seen is not None and seen.number <= position.number:
            position = seen
        return Start(position, _counts(records, session_id))


def look(database: Database, session_id: str, after: Position, *, recount: bool) -> Look | None:
    """Return what changed after a position; None once the session is deleted.

    Counts are read where a status changed, or to `recount`: they change as well where measurements are deleted.
    """
    with database.read() as records:
        if not _exists(records, session_id):
            return None
        changes, are_all = read_changes(records, session_id, after)
        counts = _counts(records, session_id) if changes or (recount and are_all) else None
        if not changes and counts is not None:  # what changed while they were read comes with the next look
            later = read_changes(records, session_id, after)
            counts = counts if not later.final and later.are_all else None
        return Look(changes[-1].position if changes else after, changes, are_all, counts)


def _exists(records: orm.Session, session_id: str) -> bool:
    return records.scalar(sa.select(Session.id).where(Session.id == session_id)) is not None


def _counts(records: orm.Session, session_id: str) -> Counts:
    return count_measurements(records, [session_id])[session_id]
