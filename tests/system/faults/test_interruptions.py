"""Killed at every fsync, halted, cut off: what was acknowledged stands, and nothing half-done is left."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import httpx2
import pytest

from app.client import ClientError, ServiceClient
from tests.support.service.service import new_session, wait_until
from tests.system.faults.images import image
from tests.system.faults.injections import build_library, cut_upload, killed_at_fsync, stopped
from tests.system.faults.supervisor import Supervisor
from tests.system.faults.trial import Trial

pytestmark = pytest.mark.soak

_FSYNCS = 36
"""Start `n` of the service ends before its `n`-th fsync: from the first on an empty folder, through keys and
migrations, to those of uploads (file, folder and row make one each), claims and results."""


def test_kill_9_at_every_fsync(
    trial: Trial, tmp_path: Path, data_dir: Path, need: Callable[[str], None]
) -> None:
    need("cc")
    library = build_library("kill_at_fsync", tmp_path)

    def wrapper(start: int) -> list[str]:
        return killed_at_fsync(library, start + 1) if start < _FSYNCS else []

    service = Supervisor(data_dir, wrapper=wrapper)
    with trial.serving(service):
        service.admin_key = _new_admin_key(data_dir)
        uploads = trial.upload(400, session_id=_session_between_kills(trial))
        uploads.wait_until(lambda: service.starts > _FSYNCS)
        uploads.stop_early()
        uploads.finish()
        # None: it ended before it said where it listens.
        trial.inject(sum(code in (None, -9) for code in service.exits))
        trial.conclude()
        assert service.starts == _FSYNCS + 1, service.exits
        assert trial.account.injected == _FSYNCS, service.exits


def _session_between_kills(trial: Trial) -> str:
    """Make a session in whatever life of the service lets it; what a killed one left of it harms nobody."""
    while True:
        try:
            return trial.new_session()
        except ClientError as error:
            if error.code != "unreachable":
                raise
            trial.service.until_ready()


def _new_admin_key(data_dir: Path) -> str:
    """Make a key as an operator does: the first one may be among what the kills interrupt."""
    made = subprocess.run(
        [sys.executable, "-m", "app.cli", "keys", "create", "trial", "--scope", "admin", "--init"],
        env={**os.environ, "GRIDPOSE_DATA_DIR": str(data_dir)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return made.stdout.splitlines()[-1]


def test_cut_uploads(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir)) as service:
        assert service.admin_key is not None
        trial.upload(40)
        with trial.client() as client:
            session_id = new_session(client)
        data = image(1000) * 200
        path = f"/v1/sessions/{session_id}/poses/P1/images/{hashlib.sha256(data).hexdigest()}"
        for number in range(20):
            trial.inject()
            cut_upload(service.url, path, service.admin_key, data, reset=number % 2 == 0)
        trial.conclude()
        wait_until(lambda: not _unfinished(data_dir), 120, "nothing is left of the cut uploads")
        with trial.client() as client:
            assert client.get(f"/v1/sessions/{session_id}/measurements")["items"] == []
        assert service.starts == 1


def _unfinished(data_dir: Path) -> list[Path]:
    return list((data_dir / "originals" / "incoming").iterdir())


def test_halted_and_resumed(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir)) as service:
        uploads = trial.upload(50)
        for acknowledged in (5, 25):
            uploads.wait_for(acknowledged)
            with stopped(service.pid):
                trial.inject()
                with pytest.raises(httpx2.ReadTimeout):
                    httpx2.get(f"{service.url}/livez", timeout=3)
        trial.conclude()
        assert service.starts == 1


def test_orderly_restarts_under_load(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir)) as service:
        uploads = trial.upload(80)
        for acknowledged in (10, 40):
            uploads.wait_for(acknowledged)
            trial.inject()
            service.restart()
        trial.conclude()
        assert service.exits == [0, 0]
        with ServiceClient(service.url, service.admin_key) as client:
            client.get("/v1/sessions")
