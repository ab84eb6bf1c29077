"""The embedded queue with 100,000 images waiting: what a claim costs, and how long a newcomer waits.

PostgreSQL is measured too where GRIDPOSE_DATABASE_URL names an empty database.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from statistics import median

import sqlalchemy as sa

from app.jobs.queue.sql_queue import SqlQueue
from app.records import migrations
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import Measurement, Pose, Session, SessionTarget, Target
from benchmarks.table import Row
from tests.support.jobs.queued_rows import QUEUED

AT_ONCE = 8
"""Jobs of one claim: those of two workers."""


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    queued, sessions = (10_000, 100) if quick else (100_000, 300)
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name:
        yield from _measure(
            "SQLite", f"sqlite:///{Path(name) / 'queue.sqlite3'}", Path(name), queued, sessions
        )
        url = os.environ.get("GRIDPOSE_DATABASE_URL")
        if url is not None:
            yield from _measure("PostgreSQL", url, Path(name), queued, sessions)


def _measure(kind: str, url: str, folder: Path, queued: int, sessions: int) -> Iterator[Row]:
    database = Database(url)
    migrations.upgrade(database, folder)
    queue = SqlQueue(database)
    for of_each, number in (([10], 1), ([queued], 1), ([queued // sessions] * sessions, sessions)):
        fill(database, of_each)
        what = f"{kind}: claim of {AT_ONCE}, {sum(of_each):,} queued in {number} session{'s'[: number > 1]}"
        times = _claims(queue, 1 if sum(of_each) < 100 else 200)
        note = f"processor time of this process, median of {len(times)}, slowest {max(times):.3g} ms"
        if sum(of_each) < 100:
            yield Row.context(what, median(times), "ms", note)
        else:
            yield Row.at_most(what, median(times), 20.0, "ms", note)
        empty(database)
    fill(database, [10_000])
    queue.claim(AT_ONCE)
    newcomer = fill(database, [10])[0]
    served = [job.measurement_id for _ in range(5) for job in queue.claim(AT_ONCE)]
    with database.read() as records:
        its = set(records.scalars(sa.select(Measurement.id).where(Measurement.session_id == newcomer)))
    places = [place for place, measurement_id in enumerate(served, 1) if measurement_id in its]
    yield Row.at_most(f"{kind}: newcomer's first image behind 10,000, place", places[0], 2)
    yield Row.at_most(f"{kind}: newcomer's tenth image behind 10,000, place", places[9], 20)
    database.dispose()


def _claims(queue: SqlQueue, claims: int) -> Sequence[float]:
    times = []
    for _ in range(claims):
        started = time.process_time()
        jobs = queue.claim(AT_ONCE)
        times.append((time.process_time() - started) * 1000.0)
        assert len(jobs) == AT_ONCE
    return times


def fill(database: Database, of_each: Sequence[int]) -> list[str]:
    """Queue so many images in a session of each; return the sessions."""
    now = datetime.now(UTC)
    target_id, session_ids = new_id("tgt"), [new_id("ses") for _ in of_each]
    measurements = (
        {
            "id": new_id("mea"),
            "session_id": session_id,
            "pose_id": "P1",
            "target_id": target_id,
            "received_at": now,
            "sha256": f"{number:064x}",
            **QUEUED,
        }
        for session_id, images in zip(session_ids, of_each, strict=True)
        for number in range(images)
    )
    with database.write() as records:
        records.add(
            Target(
                id=target_id,
                name="board",
                kind="chessboard",
                columns=9,
                rows=6,
                pitch_mm=25.0,
                legacy_layout=False,
                created_at=now,
            )
        )
        records.flush()
        records.execute(sa.insert(Session), [{"id": i, "name": "s", "created_at": now} for i in session_ids])
        records.execute(
            sa.insert(SessionTarget),
            [{"session_id": i, "position": 0, "target_id": target_id} for i in session_ids],
        )
        records.execute(
            sa.insert(Pose), [{"id": new_id("pos"), "session_id": i, "pose_id": "P1"} for i in session_ids]
        )
        while batch := list(islice(measurements, 10_000)):
            records.execute(sa.insert(Measurement), batch)
    return session_ids


def empty(database: Database) -> None:
    """Remove everything again."""
    with database.write() as records:
        for table in (Measurement, Pose, SessionTarget, Session, Target):
            records.execute(sa.delete(table))
