"""The fault programme in short, in every run of `make test-all`: one service, five faults, the same account."""

from __future__ import annotations

import hashlib
import os
import resource
import signal
import sys
from pathlib import Path

import httpx2
import pytest

from tests.support.environment.processes import cpu_seconds, worker_processes
from tests.support.service.service import new_session
from tests.system.faults.images import image
from tests.system.faults.injections import (
    cut_upload,
    limited,
    open_files,
    stopped,
)
from tests.system.faults.supervisor import Supervisor
from tests.system.faults.trial import Trial

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and signals are Linux's")


def test_faults_in_short(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir)) as service:
        assert service.admin_key is not None
        pid = service.pid
        with trial.client() as client:
            session_id = new_session(client)
        uploads = trial.upload(72, held_from=8)

        uploads.wait_for(8)
        refused = uploads.refusals["507"]
        with limited(pid, resource.RLIMIT_FSIZE, 4096):
            trial.inject()
            uploads.release(24)
            uploads.wait_until(lambda: uploads.refusals["507"] > refused)

        uploads.wait_for(24)
        refused = uploads.refusals["503"]
        with limited(pid, resource.RLIMIT_NOFILE, open_files(pid)):
            trial.inject()
            uploads.release(40)
            uploads.wait_until(lambda: uploads.refusals["503"] > refused)

        uploads.release(72)
        uploads.wait_for(40)
        trial.inject()
        os.kill(max(worker_processes(pid), key=cpu_seconds), signal.SIGKILL)

        uploads.wait_for(48)
        trial.inject()
        data = image(1000) * 50
        path = f"/v1/sessions/{session_id}/poses/P1/images/{hashlib.sha256(data).hexdigest()}"
        cut_upload(service.url, path, service.admin_key, data, reset=True)

        uploads.wait_for(56)
        with stopped(pid):
            trial.inject()
            with pytest.raises(httpx2.ReadTimeout):
                httpx2.get(f"{service.url}/livez", timeout=0.5)

        trial.conclude(excused=frozenset({"worker_crashed"}))
        assert service.starts == 1
        with trial.client() as client:
            assert client.get(f"/v1/sessions/{session_id}/measurements")["items"] == []
