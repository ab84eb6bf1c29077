"""How far a session is, for those who watch."""

from __future__ import annotations

from dataclasses import dataclass

import sqlalchemy as sa

from app.records.database import Database
from app.records.tables import Session
from app.services.sessions import Counts, count_measurements


@dataclass(frozen=True, slots=True)
class Progress:
    """How many of a session's measurements stand where."""

    session_id: str
    counts: Counts

    @property
    def pending(self) -> int:
        """How many are not finished."""
        return self.counts["queued"] + self.counts["running"]


def read_progress(database: Database, session_id: str) -> Progress | None:
    """Return a session's progress, None once it is deleted."""
    with database.read() as records:
        if records.scalar(sa.select(Session.id).where(Session.id == session_id)) is None:
            return None
        return Progress(session_id, count_measurements(records, [session_id])[session_id])
