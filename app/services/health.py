"""Health of the service, part by part."""

from __future__ import annotations

import asyncio
import math
import time
from dataclasses import dataclass

import sqlalchemy as sa
from starlette.concurrency import run_in_threadpool

from app.blobs import S3Blobs
from app.errors import ServiceError
from app.jobs.runner import JobRunner
from app.records import migrations
from app.records.database import BUSY_TIMEOUT_S, sqlite_version
from app.records.tables import Session
from app.services.installation.backends import stored_id
from app.services.installation.context import ServiceContext

CACHED_S = 2.0
ANSWER_WITHIN_S = 2.0
"""How long an answer waits for a look; a write transaction may take longer than who asks has patience."""
SILENT_S = BUSY_TIMEOUT_S + 5.0
"""How long a look may take until the database counts as one that does not answer."""


@dataclass(frozen=True, slots=True)
class Check:
    """One part's state."""

    name: str
    ok: bool
    detail: str


class HealthWatch:
    """What readiness is answered from. However many ask, database, disk and bucket are looked at by one of them, and
    not again for CACHED_S; the runner's state costs nothing and is always the present one. While a look takes longer
    than ANSWER_WITHIN_S, what was found before holds, for SILENT_S at most. For one event loop.
    """

    def __init__(self, installation: ServiceContext, runner: JobRunner | None) -> None:
        self._installation, self._runner = installation, runner
        self._latest: asyncio.Task[list[Check]] | None = None
        self._begun_at = self._looked_at = -math.inf
        self._found: list[Check] | None = None

    async def look(self) -> list[Check]:
        """Return the state of every part; never raises."""
        latest = self._latest
        if latest is None or (latest.done() and time.monotonic() - self._looked_at > CACHED_S):
            self._begun_at = time.monotonic()
            latest = self._latest = asyncio.create_task(self._look())
        # Not awaited itself: who asked first may leave while others wait.
        await asyncio.wait((latest,), timeout=ANSWER_WITHIN_S)
        found = latest.result() if latest.done() else self._found
        if found is None or (not latest.done() and time.monotonic() - self._begun_at > SILENT_S):
            found = [Check("database", ok=False, detail="The database does not answer.")]
        return [*found, _runner(self._runner)]

    async def _look(self) -> list[Check]:
        try:
            self._found = await run_in_threadpool(check_storage, self._installation)
            return self._found
        finally:
            self._looked_at = time.monotonic()


def check_storage(installation: ServiceContext) -> list[Check]:
    """Look at database, disk and bucket, which takes the write lock for a moment; never raises."""
    return [
        _database(installation),
        _migrations(installation),
        _disk(installation),
        *_bucket(installation),
    ]


def _database(installation: ServiceContext) -> Check:
    written = _written(installation)
    if installation.database.damage.seen:
        return Check(
            "database", ok=False, detail="The database is damaged: `gridpose doctor` says what to restore."
        )
    return written


def _written(installation: ServiceContext) -> Check:
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


def _migrations(installation: ServiceContext) -> Check:
    try:
        current = migrations.current_revision(installation.database)
    except sa.exc.SQLAlchemyError:
        return Check("migrations", ok=False, detail="The schema's version cannot be read.")
    head = migrations.head_revision()
    return Check(
        "migrations",
        ok=current == head,
        detail=f"The schema is at {current}."
        if current == head
        else f"The schema is at {current}, not at {head}.",
    )


def _disk(installation: ServiceContext) -> Check:
    floor = installation.settings.disk_floor_bytes
    try:
        free = installation.blobs.free_bytes()
        installation.blobs.check_access()
    except OSError as error:
        reason = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        return Check("disk", ok=False, detail=f"The originals cannot be stored or read. {reason}.")
    return Check(
        "disk",
        ok=free >= floor,
        detail=f"{free / 1e9:.1f} GB are free; uploads are refused below {floor / 1e9:.1f} GB.",
    )


def _bucket(installation: ServiceContext) -> list[Check]:
    """Read the object that names the installation; nothing to look at where originals are files."""
    if not isinstance(installation.blobs, S3Blobs):
        return []
    try:
        stored_id(installation.blobs)
    except ServiceError as error:
        return [Check("bucket", ok=False, detail=error.detail)]
    return [Check("bucket", ok=True, detail="The bucket of the originals answers.")]


def _runner(runner: JobRunner | None) -> Check:
    if runner is None:
        return Check(
            "runner", ok=True, detail="No runner in this process (GRIDPOSE_WORKERS=0); run `gridpose worker`."
        )
    state = runner.state
    if not state.running:
        return Check("runner", ok=False, detail="The embedded runner has stopped.")
    if not state.able:
        return Check(
            "runner", ok=False, detail="No image can be computed at present; the service's log says why."
        )
    if not state.ready:
        return Check("runner", ok=False, detail=f"Starting: 0 of {state.workers} worker processes are ready.")
    return Check("runner", ok=True, detail=f"Running with {state.ready} of {state.workers} worker processes.")
