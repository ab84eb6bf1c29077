"""PostgreSQL ends under the service, and runs in a time zone that is not UTC."""

from __future__ import annotations

import hashlib
import os
import shutil
import socket
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import httpx2
import pytest

from tests.support.service.service import new_session
from tests.support.service.uploads import finished_measurements
from tests.system.faults.images import BOARD, image
from tests.system.faults.supervisor import Supervisor
from tests.system.faults.trial import Trial

pytestmark = [pytest.mark.soak, pytest.mark.postgres]


class Cluster:
    """A PostgreSQL server of one's own, in a folder and on a port of its own."""

    def __init__(self, folder: Path, programs: Path) -> None:
        self._data, self._programs = folder / "cluster", programs
        self._data.mkdir(parents=True)
        with socket.create_server(("127.0.0.1", 0)) as free:
            self._port: int = free.getsockname()[1]
        if os.geteuid() == 0:
            folder.chmod(0o711)
            shutil.chown(self._data, "postgres")
        self._run(
            "initdb", "--auth=trust", "--username=gridpose", "--encoding=UTF8", "--locale=C", "--no-sync"
        )
        self.start("UTC")
        subprocess.run(
            [programs / "createdb", "-h", "127.0.0.1", "-p", str(self._port), "-U", "gridpose", "gridpose"],
            check=True,
        )
        self.url = f"postgresql+psycopg://gridpose@127.0.0.1:{self._port}/gridpose"

    def start(self, time_zone: str) -> None:
        options = f"-h 127.0.0.1 -p {self._port} -k {self._data} -c timezone={time_zone}"
        self._run("pg_ctl", "-l", str(self._data / "log"), "-w", "-o", options, "start")

    def stop(self, mode: str) -> None:
        self._run("pg_ctl", "-m", mode, "-w", "stop")

    def _run(self, program: str, *arguments: str) -> None:
        command: Sequence[str] = [str(self._programs / program), "-D", str(self._data), *arguments]
        if os.geteuid() == 0:
            command = ["runuser", "-u", "postgres", "--", *command]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd="/")


@pytest.fixture
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    programs = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"))
    if not programs:
        if os.environ.get("CI"):
            pytest.fail("PostgreSQL's own programs are required here")
        pytest.skip("PostgreSQL's own programs (initdb, pg_ctl) are not installed")
    folder = Path(tempfile.mkdtemp(prefix="gridpose-cluster-"))
    try:
        cluster = Cluster(folder, programs[-1].parent)
        yield cluster
        cluster.stop("immediate")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


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
