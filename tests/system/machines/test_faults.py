"""Several machines under faults: nothing that was acknowledged is lost, done twice, or stuck."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import sqlalchemy as sa

from app.records.database import Database
from app.records.tables import Measurement, Result
from tests.support.environment.machines import Machines, Uploads
from tests.support.environment.object_store import ObjectStore, object_store
from tests.support.environment.postgres import new_database
from tests.support.environment.postgres_cluster import own_cluster
from tests.support.environment.proxy import Proxy
from tests.support.image.images import small_image
from tests.support.service.service import wait_until

pytestmark = pytest.mark.postgres
RESCUED_WITHIN_S = 30.0
SLACK_S = 90.0
"""What a busy build server adds to everything."""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ObjectStore]:
    with object_store(tmp_path_factory.mktemp("objects")) as running:
        yield running


@contextmanager
def installation(store: ObjectStore, url: str) -> Iterator[tuple[dict[str, str], Proxy, Proxy]]:
    """The environment of a new installation, and the proxies through which workers reach S3 and everyone PostgreSQL."""
    address = sa.make_url(url)
    objects, rows = Proxy(store.port), Proxy(address.port or 5432)
    yield (
        {
            **store.environment(),
            "GRIDPOSE_DATABASE_URL": address.set(host="127.0.0.1", port=rows.port).render_as_string(
                hide_password=False
            ),
            "GRIDPOSE_BLOB_URL": f"s3://{store.new_bucket()}/faults",
            "GRIDPOSE_KEY_PEPPER": "0" * 64,
            "GRIDPOSE_DISK_FLOOR_BYTES": "0",
        },
        objects,
        rows,
    )
    objects.close()
    rows.close()


@contextmanager
def running(root: Path, environment: dict[str, str], objects: Proxy, *, workers: int) -> Iterator[Machines]:
    """Two services and some workers, which reach S3 through a proxy; killed at the end."""
    machines = Machines(
        root,
        environment,
        heads=2,
        workers=workers,
        of_workers={"AWS_ENDPOINT_URL": f"http://127.0.0.1:{objects.port}"},
    )
    machines.start()
    try:
        yield machines
    finally:
        for head in machines.heads:
            with suppress(AssertionError):
                head.kill()
        for worker in machines.workers:
            worker.kill()


def conclude(machines: Machines, uploads: Uploads, session_id: str, url: str, within_s: float) -> None:
    """Wait until every acknowledged image is computed, and show that each is there once, whole and with one result."""
    uploads.join()

    def is_done() -> bool:
        counts = machines.counts(session_id)
        return counts["queued"] + counts["running"] == 0

    wait_until(is_done, within_s, "every image is computed")
    database = Database(url)
    with database.read() as records:
        rows = records.execute(
            sa.select(Measurement.id, Measurement.sha256, Measurement.status, Measurement.failure_code)
        ).all()
        results = records.scalar(sa.select(sa.func.count()).select_from(Result))
    database.dispose()
    assert {row.sha256: row.id for row in rows} == uploads.acknowledged, "each once, none lost"
    assert {row.failure_code for row in rows} == {"target_not_found"}
    assert results == len(rows)
    with machines.client(len(machines.heads) - 1) as client:
        for row in random.Random(1).sample(rows, min(10, len(rows))):
            assert client.get(f"/v1/measurements/{row.id}/image").status_code == 200


def test_killed_cut_and_refused(store: ObjectStore, tmp_path: Path) -> None:
    with (
        new_database() as url,
        installation(store, url) as (environment, objects, rows),
        running(tmp_path / "m", environment, objects, workers=2) as machines,
    ):
        session_id = machines.make_session()
        uploads = Uploads(machines, session_id, [small_image(n) for n in range(60)])
        wait_until(lambda: len(uploads.acknowledged) > 15, 30.0 + SLACK_S, "uploads arrive")
        machines.workers[0].kill()
        machines.heads[0].kill()
        wait_until(lambda: len(uploads.acknowledged) > 25, 30.0 + SLACK_S, "the other service takes uploads")
        objects.set("503")
        rows.set("cut")
        time.sleep(2.0)
        rows.set("pass")
        time.sleep(2.0)
        objects.set("pass")
        machines.heads[0].start()
        conclude(
            machines, uploads, session_id, environment["GRIDPOSE_DATABASE_URL"], RESCUED_WITHIN_S + SLACK_S
        )


@pytest.mark.soak
def test_faults_of_every_kind_for_minutes(store: ObjectStore, tmp_path: Path) -> None:
    with (
        own_cluster() as cluster,
        installation(store, cluster.url) as (environment, objects, rows),
        running(tmp_path / "m", environment, objects, workers=3) as machines,
    ):
        chance = random.Random(20261123)
        session_id = machines.make_session()
        uploads = Uploads(machines, session_id, [small_image(n) for n in range(4000)], clients=4)
        for _ in range(30):
            time.sleep(chance.uniform(1.0, 5.0))
            match chance.choice(("worker", "head", "503", "slow", "cut", "database")):
                case "worker":
                    worker = chance.choice(machines.workers)
                    worker.kill()
                    worker.start()
                case "head":
                    head = chance.choice(machines.heads)
                    head.kill()
                    head.start()
                case "503":
                    objects.set("503")
                    time.sleep(chance.uniform(1.0, 8.0))
                    objects.set("pass")
                case "slow":
                    objects.set("slow")
                    rows.set("slow")
                    time.sleep(3.0)
                    objects.set("pass")
                    rows.set("pass")
                case "cut":
                    rows.set("cut")
                    time.sleep(chance.uniform(0.5, 6.0))
                    rows.set("pass")
                case "database":
                    cluster.stop(chance.choice(("fast", "immediate")))
                    time.sleep(chance.uniform(0.0, 4.0))
                    cluster.start("UTC")
        conclude(machines, uploads, session_id, environment["GRIDPOSE_DATABASE_URL"], 300.0)
