"""What is reported to systemd, over a real socket, and the end of a service that can compute nothing."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from app.services.installation.context import ServiceContext
from app.settings import Settings

if sys.platform != "linux":
    pytest.skip("systemd and limits of running processes", allow_module_level=True)
import resource

from tests.support.environment.processes import worker_processes
from tests.support.environment.systemd import listening, message
from tests.support.image.images import small_image
from tests.support.service.service import new_session, put, wait_until

MakeService = Callable[..., ServiceProcess]


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    """The socket that messages arrive at."""
    with listening(tmp_path / "notify") as listener:
        yield listener


def test_the_service_is_ready_when_readyz_is_and_says_how_it_goes_on(
    make_service: MakeService, systemd: socket.socket
) -> None:
    settings = {"NOTIFY_SOCKET": systemd.getsockname(), "WATCHDOG_USEC": "1000000"}
    service = make_service(**settings).start(until_ready=False)
    key = {"Authorization": f"Bearer {service.admin_key}"}
    early = httpx2.get(f"{service.url}/readyz", headers=key, timeout=120.0)
    if early.status_code == 503:  # on any machine we know of
        assert "Starting: 0 of 1 worker processes are ready." in early.text
    while (said := message(systemd))[0] != "READY=1":
        assert said[0].startswith("EXTEND_TIMEOUT_USEC=")
    ready = httpx2.get(f"{service.url}/readyz", timeout=120.0)
    assert ready.status_code == 200, ready.text
    assert [message(systemd) for _ in range(3)] == [["WATCHDOG=1"]] * 3
    assert service.stop() == 0
    while (said := message(systemd)) == ["WATCHDOG=1"]:
        pass
    assert said == ["STOPPING=1"]


@pytest.fixture
def worker_process(tmp_path: Path, systemd: socket.socket) -> Iterator[subprocess.Popen[bytes]]:
    """`gridpose worker` on a data folder of its own; it says over the socket when it is ready."""
    settings = {"NOTIFY_SOCKET": systemd.getsockname(), "GRIDPOSE_WORKERS": "1"}
    data_dir = tmp_path / "other"
    ServiceContext.open(Settings(data_dir=data_dir, workers=1)).close()  # `worker` makes none
    with subprocess.Popen(
        [sys.executable, "-m", "app.cli", "worker", "--data-dir", str(data_dir)],
        env={**os.environ, **settings},
        stderr=subprocess.DEVNULL,
    ) as process:
        yield process
        process.kill()


def test_a_service_and_a_worker_that_can_compute_nothing_end_by_themselves(
    make_service: MakeService, worker_process: subprocess.Popen[bytes], systemd: socket.socket
) -> None:
    """Their worker processes are killed, and no other can be started for want of descriptors."""
    service = make_service().start()
    while message(systemd)[0] != "READY=1":
        pass
    processes: list[subprocess.Popen[Any]] = [service.process, worker_process]
    for process in processes:
        children = worker_processes(process.pid)
        resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (8, 4096))
        for child in children:
            os.kill(child, signal.SIGKILL)
    started = time.monotonic()
    assert [process.wait(120.0) for process in processes] == [1, 1]
    assert time.monotonic() - started > 30.0, "it waits for the shortage to pass first"
    log = (service.data_dir / "service.log").read_text()
    assert "nothing_can_be_computed" in log


def test_a_service_whose_descriptors_ran_short_computes_again(make_service: MakeService) -> None:
    """The idle worker is killed while none can be started; the limit is lifted some seconds later."""
    service = make_service().start()
    usual = resource.prlimit(service.process.pid, resource.RLIMIT_NOFILE)
    (worker,) = worker_processes(service.process.pid)
    log = service.data_dir / "service.log"
    resource.prlimit(service.process.pid, resource.RLIMIT_NOFILE, (8, usual[1]))
    os.kill(worker, signal.SIGKILL)
    wait_until(lambda: log.read_text().count("worker_not_started") >= 3, 120, "a worker was not started")
    resource.prlimit(service.process.pid, resource.RLIMIT_NOFILE, usual)
    with ServiceClient(service.url, service.admin_key) as client:
        session_id = new_session(client)
        data = small_image(1)
        put(client, session_id, data)

        def finished() -> bool:
            return bool(client.get(f"/v1/sessions/{session_id}")["counts"]["failed"] == 1)

        wait_until(finished, 120, "the image is computed")
    assert httpx2.get(f"{service.url}/readyz", timeout=120.0).status_code == 200
    assert service.stop() == 0
