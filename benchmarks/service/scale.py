"""Several machines, as processes of this one: PostgreSQL, S3, services and workers, real images over HTTP.

PostgreSQL is that of GRIDPOSE_TEST_POSTGRES_URL, or the usual port of this machine; S3 is SeaweedFS. Everything shares
this machine's cores, so that more workers than cores show the cost of sharing and not a limit of the queue.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median

import sqlalchemy as sa

from app.records import migrations
from app.records.database import Database
from app.records.tables import Measurement
from benchmarks.table import Row
from core.simulation.renderer import render
from core.targets.specification import TargetSpec
from tests.support.environment.machines import Machines, Uploads
from tests.support.environment.object_store import object_store
from tests.support.environment.postgres import new_database
from tests.support.image.images import encode
from tests.support.jobs.queued_rows import enqueue, make_session
from tests.support.simulation.scenes import standard_scene

CLIENTS = 8
SETTINGS = ((1, 1, 1), (1, 2, 1), (1, 4, 1), (2, 2, 1))
"""Services, workers, and processes of each worker."""


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    yield from _database(200 if quick else 1000)
    images = 60 if quick else 400
    target = TargetSpec("chessboard", 9, 6, 25.0)
    board = encode(
        ".png", render(standard_scene(target, seed=seeds[0], tilt=math.radians(30.0), clutter=0.0))
    )
    with tempfile.TemporaryDirectory(prefix="gridpose-bench-") as name, object_store(Path(name)) as store:
        for heads, workers, processes in SETTINGS:
            with new_database() as url:
                environment = {
                    **store.environment(),
                    "GRIDPOSE_DATABASE_URL": url,
                    "GRIDPOSE_BLOB_URL": f"s3://{store.new_bucket()}/bench",
                    "GRIDPOSE_KEY_PEPPER": "0" * 64,
                    "GRIDPOSE_DISK_FLOOR_BYTES": "0",
                }
                folder = Path(name) / f"{heads}-{workers}"
                machines = Machines(folder, environment, heads=heads, workers=workers, processes=processes)
                machines.start()
                try:
                    yield from _through(machines, board, images, f"{heads} services, {workers} workers")
                finally:
                    machines.stop()


def _through(machines: Machines, board: bytes, images: int, what: str) -> Iterator[Row]:
    session_id = machines.make_session()
    # Workers that have just been started still load what they compute with.
    Uploads(machines, session_id, [board + bytes([n]) for n in range(8)]).join()
    _wait(machines, session_id)
    data = [board + n.to_bytes(4, "big") for n in range(images)]
    started = time.monotonic()
    uploads = Uploads(machines, session_id, data, clients=CLIENTS)
    uploads.join()
    sent_s = time.monotonic() - started
    _wait(machines, session_id)
    computed_s = time.monotonic() - started
    note = f"{images} images of {len(board) // 1000} kB, {CLIENTS} clients"
    yield Row.context(f"{what}: images acknowledged", images / sent_s, "1/s", note)
    yield Row.context(f"{what}: acknowledgement, median", 1000 * median(uploads.waits_s), "ms", note)
    yield Row.context(f"{what}: images measured", images / computed_s, "1/s", note)


def _wait(machines: Machines, session_id: str) -> None:
    while True:
        counts = machines.counts(session_id)
        if counts["queued"] + counts["running"] == 0:
            return
        time.sleep(0.02)


def _database(transactions: int) -> Iterator[Row]:
    """What a row and its job cost the server."""
    with new_database() as url, tempfile.TemporaryDirectory() as folder:
        database = Database(url)
        migrations.upgrade(database, Path(folder))
        sessions = [make_session(database) for _ in range(CLIENTS)]
        with ThreadPoolExecutor(CLIENTS) as threads:
            list(threads.map(lambda session: enqueue(database, session, 1), sessions))
            started = time.monotonic()
            list(threads.map(lambda n: enqueue(database, sessions[n % CLIENTS], 1), range(transactions)))
            rate = transactions / (time.monotonic() - started)
        yield Row.context(
            "rows queued, one a transaction", rate, "1/s", f"{CLIENTS} threads, as many sessions"
        )
        with database.write() as records:
            records.execute(sa.update(Measurement).values(status="running"))
            started = time.monotonic()
            records.execute(sa.update(Measurement).values(status="queued"))
            again_s = time.monotonic() - started
        yield Row.context("rows queued again, all in one statement", transactions / again_s, "1/s", "")
        alone = [_timed(lambda: enqueue(database, sessions[1], 1)) for _ in range(50)]
        yield Row.context(
            f"a row queued behind {transactions}, median", 1000 * median(alone), "ms", "one thread"
        )
        database.dispose()


def _timed(work: object) -> float:
    assert callable(work)
    started = time.monotonic()
    work()
    return time.monotonic() - started
