"""Sessions whose images are all measured: found by looking, so that no upload and no result costs more for it.

A session is in progress from the look that finds images of it that are new, or waiting, until `QUIET_S` after the last
of them. What is in progress is stored, so that a restart forgets none.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.database import Database
from app.records.ids import least_id, moment_of
from app.records.tables import Measurement, NoticeMark, Session
from app.services.notices import note, of_session

QUIET_S = 60.0
"""How long nothing comes, and nothing waits, until a session counts as measured."""
_MAX_OVERLAP_S = 20.0
"""Of two looks: ids of other machines may be this much behind."""
_LOOKED = "looked"
_PENDING = ("queued", "running")


class MeasuredSessions:
    """Looks for sessions that came to an end."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def look(self, now: datetime | None = None) -> int:
        """Mark the sessions that are in progress, note those that are no longer; return how many these are."""
        now = now or datetime.now(UTC)
        with self._database.read() as records:
            looked = records.get(NoticeMark, _LOOKED)
            since = now if looked is None else looked.at
            in_progress = self._in_progress(records, min(since, now), now)
            marks = {
                mark.name: mark.at
                for mark in records.scalars(sa.select(NoticeMark).where(NoticeMark.name != _LOOKED))
            }
            ended = [
                name
                for name, at in marks.items()
                if name not in in_progress and abs((now - at).total_seconds()) >= QUIET_S
            ]
        is_due = looked is None or bool(in_progress) or bool(ended) or now - since > timedelta(minutes=5)
        if not is_due:
            return 0
        with self._database.write() as records:
            self._mark(records, {_LOOKED: now, **in_progress})
            return sum(self._note_end(records, session_id) for session_id in ended)

    def _in_progress(self, records: orm.Session, since: datetime, until: datetime) -> dict[str, datetime]:
        """Return the sessions with images that wait, or that came between two moments, and when that last was."""
        now = datetime.now(UTC)
        overlap = timedelta(seconds=min(_MAX_OVERLAP_S, QUIET_S / 3.0))
        found = dict.fromkeys(
            records.scalars(
                sa.select(Measurement.session_id).where(Measurement.status.in_(_PENDING)).distinct()
            ),
            now,
        )
        # Ids find few rows, but were the clock ever ahead, all ids since then lie ahead of it and say nothing.
        new = sa.select(Measurement.session_id, sa.func.max(Measurement.id)).where(
            Measurement.id > least_id("mea", since - overlap),
            Measurement.received_at.between(since - overlap, until + overlap),
        )
        for session_id, latest in records.execute(new.group_by(Measurement.session_id)):
            found.setdefault(session_id, min(moment_of(latest), now))
        return found

    def _mark(self, records: orm.Session, marks: dict[str, datetime]) -> None:
        for name, at in marks.items():
            row = records.get(NoticeMark, name)
            if row is None:
                records.add(NoticeMark(name=name, at=at))
            else:
                row.at = at

    def _note_end(self, records: orm.Session, session_id: str) -> bool:
        """Note that a session is measured, unless another service did or an image came meanwhile."""
        pending = sa.exists().where(Measurement.session_id == session_id, Measurement.status.in_(_PENDING))
        if records.scalar(sa.select(pending)):
            return False
        gone = records.execute(
            sa.delete(NoticeMark).where(NoticeMark.name == session_id).returning(NoticeMark.name)
        ).all()
        if not gone or records.get(Session, session_id) is None:
            return False
        counts = records.execute(
            sa.select(Measurement.status, sa.func.count())
            .where(Measurement.session_id == session_id)
            .group_by(Measurement.status)
        ).all()
        by_status = {row[0]: row[1] for row in counts}
        data = {
            **of_session(records, session_id),
            "succeeded": by_status.get("succeeded", 0),
            "failed": by_status.get("failed", 0),
        }
        note(records, "session.measured", data)
        return True
