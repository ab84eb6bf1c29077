"""Is the service able to do its work? Each part by name."""

from __future__ import annotations

from dataclasses import dataclass

import sqlalchemy as sa

from app.errors import ServiceError
from app.jobs.embedded import EmbeddedRunner
from app.records import schema
from app.records.database import sqlite_version
from app.records.tables import Session
from app.services.installation import Installation


@dataclass(frozen=True, slots=True)
class Check:
    """One part's state."""

    name: str
    ok: bool
    detail: str


def check_health(installation: Installation, runner: EmbeddedRunner | None) -> list[Check]:
    """Look at every part; never raises."""
    return [
        _database(installation),
        _migrations(installation),
        _disk(installation),
        _runner(installation, runner),
    ]


def _database(installation: Installation) -> Check:
    try:
        with installation.database.write() as records:
            # Takes the write lock and writes nothing.
            records.execute(sa.text("DELETE FROM api_keys WHERE 1 = 0"))
            records.execute(sa.select(Session.id).limit(1))
    except (ServiceError, sa.exc.SQLAlchemyError):
        return Check("database", ok=False, detail="The database cannot be written to.")
    if not installation.database.is_sqlite:
        return Check("database", ok=True, detail="PostgreSQL is writable.")
    version, sound = sqlite_version()
    note = "" if sound else "; this version can lose commits, install pysqlite3"
    return Check("database", ok=True, detail=f"SQLite {version} is writable{note}.")


def _migrations(installation: Installation) -> Check:
    try:
        current = schema.current_revision(installation.database)
    except sa.exc.SQLAlchemyError:
        return Check("migrations", ok=False, detail="The schema's version cannot be read.")
    head = schema.head_revision()
    return Check(
        "migrations",
        ok=current == head,
        detail=f"The schema is at {current}."
        if current == head
        else f"The schema is at {current}, not at {head}.",
    )


def _disk(installation: Installation) -> Check:
    free, floor = installation.blobs.free_bytes(), installation.settings.disk_floor_bytes
    return Check("disk", ok=free >= floor, detail=f"{free} bytes are free; the floor is {floor}.")


def _runner(installation: Installation, runner: EmbeddedRunner | None) -> Check:
    if runner is None:
        return Check(
            "runner", ok=True, detail="No runner in this process (GRIDPOSE_WORKERS=0); run `gridpose worker`."
        )
    workers = installation.settings.worker_count
    if runner.alive:
        return Check("runner", ok=True, detail=f"Running with {workers} worker processes.")
    return Check("runner", ok=False, detail="The embedded runner has stopped.")
