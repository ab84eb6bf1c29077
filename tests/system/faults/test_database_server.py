"""PostgreSQL ends under the service, and runs in a time zone that is not UTC."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from tests.support.environment.postgres_cluster import Cluster, own_cluster
from tests.support.service.service import new_session
from tests.support.service.uploads import finished_measurements
from tests.system.faults.images import BOARD, image
from tests.system.faults.supervisor import Supervisor
from tests.system.faults.trial import Trial

pytestmark = [pytest.mark.soak, pytest.mark.postgres]


@pytest.fixture
def cluster() -> Iterator[Cluster]:
    with own_cluster() as running:
        yield running


def test_database_server_restarts_in_odd_time_zones(trial: Trial, data_dir: Path, cluster: Cluster) -> None:
    environment = {"GRIDPOSE_DATABASE_URL": cluster.url, "TZ": "Australia/Lord_Howe"}
    with trial.serving(Supervisor(data_dir, environment)) as service:
        uploads = trial.upload(60)
        for acknowledged, mode, zone in (
            (8, "fast", "Pacific/Kiritimati"),
            (20, "immediate", "America/St_Johns"),
            (35, "immediate", "Asia/Kolkata"),
        ):
            uploads.wait_for(acknowledged)
            trial.inject()
            cluster.stop(mode)
            cluster.start(zone)
        trial.conclude()

        # The latest moment that Python knows lies after it in any zone east of Greenwich: it never gets that far.
        trial.inject()
        with trial.client() as client:
            session_id = new_session(client, BOARD)
        data = image(500)
        sent = httpx2.put(
            f"{service.url}/v1/sessions/{session_id}/poses/P1/images/{hashlib.sha256(data).hexdigest()}",
            params={"captured_at": "9999-12-31T23:59:59Z"},
            content=data,
            headers={
                "Authorization": f"Bearer {service.admin_key}",
                "Content-Type": "application/octet-stream",
            },
        )
        assert (sent.status_code, sent.json()["code"]) == (422, "invalid_request"), sent.text
        trial.upload(16, first=60)
        trial.conclude()
        with trial.client() as client:
            assert finished_measurements(client, session_id) == []
