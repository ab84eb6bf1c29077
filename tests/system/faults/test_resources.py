"""Nothing left to take: disk, file descriptors, file size, memory, processes. The service refuses and goes on."""

from __future__ import annotations

import contextlib
import hashlib
import os
import resource
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.environment.processes import cpu_seconds, worker_processes
from tests.support.image.images import slow_image
from tests.support.service.service import new_session, wait_until
from tests.system.faults.images import BOARD
from tests.system.faults.injections import (
    address_space,
    answers,
    filled,
    limited,
    open_files,
    small_disk,
)
from tests.system.faults.supervisor import Supervisor
from tests.system.faults.trial import Trial

pytestmark = pytest.mark.soak


def test_full_disk_then_room_again(trial: Trial, tmp_path: Path, need: Callable[[str], None]) -> None:
    need("mount")
    with small_disk(tmp_path / "disk", 48) as disk:
        service = Supervisor(disk / "data", {"GRIDPOSE_DISK_FLOOR_BYTES": "0"})
        with trial.serving(service):
            uploads = trial.upload(60, held_from=10)
            for acknowledged, released in ((10, 25), (25, 40), (40, 60)):
                uploads.wait_for(acknowledged)
                refused = uploads.refusals["507"]
                with filled(disk):
                    trial.inject()
                    uploads.release(released)
                    uploads.wait_until(lambda least=refused + 2: uploads.refusals["507"] >= least)
                    assert answers(service.url, 10)
            trial.conclude()
            assert service.starts == 1


def test_file_size_limit(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir)) as service:
        uploads = trial.upload(40, held_from=8)
        for acknowledged, released in ((8, 20), (20, 40)):
            uploads.wait_for(acknowledged)
            refused = uploads.refusals["507"]
            with limited(service.pid, resource.RLIMIT_FSIZE, 4096):
                trial.inject()
                uploads.release(released)
                uploads.wait_until(lambda least=refused + 2: uploads.refusals["507"] >= least)
                assert answers(service.url, 10)
        trial.conclude()
        assert service.starts == 1


def test_no_file_descriptors_while_an_idle_worker_dies(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir, {"GRIDPOSE_WORKERS": "2"})) as service:
        trial.upload(8).finish()
        pid = service.pid
        worker = min(worker_processes(pid))
        with limited(pid, resource.RLIMIT_NOFILE, open_files(pid)):
            trial.inject(2)
            os.kill(worker, signal.SIGKILL)
            uploads = trial.upload(24, first=8) if answers(service.url, 1) else None
            # As long as the shortage of the audit's finding.
            ends = time.monotonic() + 4
            wait_until(lambda: time.monotonic() > ends, 120, "the shortage lasts")
        if uploads is None:
            trial.upload(24, first=8)
        trial.conclude()


def test_no_file_descriptors_under_load(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir)) as service:
        uploads = trial.upload(60)
        for acknowledged in (8, 24):
            uploads.wait_for(acknowledged)
            with limited(service.pid, resource.RLIMIT_NOFILE, open_files(service.pid)):
                trial.inject()
                ends = time.monotonic() + 2
                wait_until(lambda ends=ends: time.monotonic() > ends, 120, "the shortage lasts")
        trial.conclude()
        assert service.starts == 1


def test_out_of_memory_in_a_worker(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir)) as service:
        trial.upload(8).finish()
        slow = _upload_slow(trial)
        (worker,) = worker_processes(service.pid)
        with limited(worker, resource.RLIMIT_AS, address_space(worker) + 4 * 1024 * 1024):
            trial.inject()
            uploads = trial.upload(24, first=8)
            wait_until(lambda: _ended(trial, slow), 90, "the large image came to an end")
            with trial.client() as client:
                failure = client.get(f"/v1/measurements/{slow}")["failure"]
            assert failure["code"]
            assert failure["advice"]
        uploads.finish()
        # What cannot be computed for want of memory may be refused, and can be had when there is memory again.
        trial.conclude(excused=frozenset({"worker_crashed", "out_of_memory", "internal_error"}))
        with trial.client() as client:
            client.create(f"/v1/measurements/{slow}/retry", {})
        wait_until(lambda: _ended(trial, slow), 90, "the large image is computed again")
        with trial.client() as client:
            assert client.get(f"/v1/measurements/{slow}")["failure"]["code"] == "target_not_found"


def test_worker_killed_as_for_want_of_memory(trial: Trial, data_dir: Path) -> None:
    with trial.serving(Supervisor(data_dir, {"GRIDPOSE_WORKERS": "2"})) as service:
        uploads = trial.upload(120)
        for acknowledged in (10, 30, 50, 70, 90):
            uploads.wait_for(acknowledged)
            workers = worker_processes(service.pid)
            if workers:
                trial.inject()
                with contextlib.suppress(ProcessLookupError):
                    os.kill(max(workers, key=cpu_seconds), signal.SIGKILL)
        trial.conclude(excused=frozenset({"worker_crashed"}))
        wait_until(lambda: len(worker_processes(service.pid)) >= 2, 120, "both workers are there again")
        assert service.starts == 1


def _upload_slow(trial: Trial) -> str:
    """Upload an image that takes seconds and much memory; return its measurement's id."""
    data = slow_image()
    with trial.client() as client:
        session_id = new_session(client, BOARD)
        measurement_id: str = client.put_image(session_id, "large", hashlib.sha256(data).hexdigest(), data)[
            "id"
        ]
    return measurement_id


def _ended(trial: Trial, measurement_id: str) -> bool:
    with trial.client() as client:
        return client.get(f"/v1/measurements/{measurement_id}")["status"] in ("succeeded", "failed")
