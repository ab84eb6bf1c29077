"""A runner whose workers, queue or descriptors fail: computing goes on, or the runner says that it cannot."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.errors import StorageFull
from app.jobs.process_image import process_image
from app.jobs.queue import Job, JobResult
from app.jobs.queue.sql_queue import SqlQueue
from app.jobs.worker_pool import WorkerSlot
from app.records.file_lock import AlreadyLocked
from app.records.presence import ADVISORY_LOCK
from app.services.health import HealthWatch
from tests.support.environment.processes import OwnWorkers
from tests.support.jobs.computations import start_after
from tests.support.jobs.runners import queue_images, runner_of
from tests.support.service.service import wait_until

if sys.platform == "win32":
    pytest.skip("limits of processes and /proc", allow_module_level=True)
import resource

SECONDS = 120.0


@contextmanager
def descriptors_short() -> Iterator[None]:
    """Let this process open no more files; those that are open stay."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    # Few enough that what is closed meanwhile lies above the limit, and enough for poll(), which obeys it too.
    limit, held = 16, [os.open("/dev/null", os.O_RDONLY)]
    while held[-1] < limit:
        held.append(os.dup(held[0]))
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        for descriptor in held:
            os.close(descriptor)


@pytest.mark.slow
def test_computing_goes_on_after_descriptors_ran_short(
    api: Any, grey_png: bytes, own_workers: OwnWorkers
) -> None:
    """The idle worker dies meanwhile, and no other can be started."""
    with runner_of(api) as runner:
        wait_until(lambda: runner.state.ready == 1)
        (queued,) = queue_images(api, grey_png, "a")
        api.wait_for(queued)
        (worker,) = own_workers()
        with descriptors_short():
            os.kill(worker, signal.SIGKILL)
            wait_until(lambda: not runner.state.able)
            assert runner.state.ready == 0
            assert runner.alive
        for measurement_id in queue_images(api, grey_png, "ab"):
            assert api.wait_for(measurement_id)["failure"]["code"] == "target_not_found"
        wait_until(lambda: runner.state.able)
        assert not runner.given_up


@pytest.mark.slow
def test_workers_that_live_and_are_ready_are_counted(
    api: Any, own_workers: OwnWorkers, tmp_path: Path
) -> None:
    def check() -> tuple[bool, str]:
        health = asyncio.run(HealthWatch(api.installation, runner).look())[-1]
        assert health.name == "runner"
        return health.ok, health.detail

    gate = tmp_path / "gate"  # a look at the database may take longer than a worker's start
    with runner_of(api, workers=2, initialise=partial(start_after, str(gate))) as runner:
        ok, detail = check()
        assert not ok
        assert detail in (
            "Starting: 0 of 2 worker processes are ready.",
            "The embedded runner has stopped.",
        )
        gate.touch()
        wait_until(lambda: runner.state.ready == 2)
        assert check() == (True, "Running with 2 of 2 worker processes.")
        first, second = own_workers()
        with descriptors_short():
            os.kill(first, signal.SIGKILL)
            wait_until(lambda: runner.state.ready == 1)
            one = runner.state
            os.kill(second, signal.SIGKILL)
            wait_until(lambda: runner.state.ready == 0 and not runner.state.able)
            none = runner.state
        assert (one.running, one.able, one.workers) == (True, True, 2)
        assert (none.running, none.able, none.workers) == (True, False, 2)
        wait_until(lambda: runner.state.ready == 2)
        assert check() == (True, "Running with 2 of 2 worker processes.")
    assert check() == (False, "The embedded runner has stopped.")


@pytest.mark.slow
def test_a_runner_that_can_start_no_worker_gives_up(api: Any, own_workers: OwnWorkers) -> None:
    with runner_of(api, max_unable_s=0.5) as runner:
        wait_until(lambda: runner.state.ready == 1)
        assert not runner.given_up
        (worker,) = own_workers()
        with descriptors_short():
            os.kill(worker, signal.SIGKILL)
            wait_until(lambda: runner.given_up)
    assert not runner.given_up  # it was asked to stop


@pytest.mark.slow
def test_a_long_start_after_one_that_failed_is_waited_for(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    start, starts = WorkerSlot._start, 0

    class NeverReady(Future[None]):
        def done(self) -> bool:
            return False

    def fail_then_take_long(slot: WorkerSlot) -> None:
        nonlocal starts
        starts += 1
        if starts == 1:
            slot._starts.failed()
            return
        start(slot)
        assert slot._process is not None
        slot._process.greeting = NeverReady()

    monkeypatch.setattr(WorkerSlot, "_start", fail_then_take_long)
    with runner_of(api, max_unable_s=2.0) as runner:
        wait_until(lambda: starts == 2)
        wait_until(lambda: runner.state.able)
        time.sleep(3.0)  # longer than it may be unable
        assert (starts, runner.state.able, runner.given_up) == (2, True, False)


@pytest.mark.slow
def test_a_runner_whose_round_does_not_end_is_not_able(api: Any) -> None:
    answered = threading.Event()

    class SilentQueue(SqlQueue):
        def claim(self, limit: int) -> Sequence[Job]:
            answered.wait(SECONDS)
            return super().claim(limit)

    with runner_of(api, SilentQueue(api.installation.database), max_round_s=3.0) as runner:
        assert runner.state.able
        wait_until(lambda: not runner.state.able)
        assert not runner.given_up
        answered.set()
        wait_until(lambda: runner.state.able)


class FaultyQueue(SqlQueue):
    """The product's queue, with errors put in before what it does."""

    def __init__(self, api: Any, *, claims: int = 0, saves: int = 0, refused: str | None = None) -> None:
        super().__init__(api.installation.database)
        self.claims, self.saves, self.refused = claims, saves, refused
        self.error: Exception = ArithmeticError("nobody foresaw this")

    def claim(self, limit: int) -> Sequence[Job]:
        self.claims -= 1
        if self.claims >= 0:
            raise self.error
        return super().claim(limit)

    def finish(self, finished: Sequence[JobResult]) -> int:
        self.saves -= 1
        if self.saves >= 0 or self.refused in [item.job.measurement_id for item in finished]:
            raise self.error
        return super().finish(finished)


@pytest.mark.slow
def test_errors_of_the_queue_that_nobody_foresaw_pass(api: Any, grey_png: bytes) -> None:
    ids_of_jobs = queue_images(api, grey_png, "abc")
    with runner_of(api, FaultyQueue(api, claims=3, saves=6)) as runner:
        documents = [api.wait_for(measurement_id) for measurement_id in ids_of_jobs]
        assert runner.alive
    assert [(each["failure"]["code"], each["attempts"]) for each in documents] == [
        ("target_not_found", 1)
    ] * 3


@pytest.mark.slow
def test_a_queue_that_raises_repeatedly_ends_in_giving_up_and_a_full_disk_does_not(
    api: Any, grey_png: bytes
) -> None:
    queue = FaultyQueue(api, claims=10**9)
    with runner_of(api, queue, max_unable_s=0.5) as runner:
        wait_until(lambda: runner.given_up)
    full = FaultyQueue(api, claims=4)
    full.error = StorageFull()
    (queued,) = queue_images(api, grey_png, "a")
    able = []
    with runner_of(api, full, max_unable_s=0.5) as runner:
        while api.measurement(queued)["status"] == "queued":
            able.append(runner.state.able and not runner.given_up)
            time.sleep(0.02)
        assert api.wait_for(queued)["attempts"] == 1
    assert all(able)


@pytest.mark.slow
def test_a_result_that_cannot_be_saved_keeps_no_other_from_it(api: Any, grey_png: bytes) -> None:
    bad, *others = queue_images(api, grey_png, "abcd")

    def has_failed() -> bool:
        api.wait_for(queue_images(api, grey_png, "e")[0])  # another is saved meanwhile
        time.sleep(1.0)  # it takes half a minute, with pauses of up to 5 s
        return api.measurement(bad)["status"] == "failed"

    with runner_of(api, FaultyQueue(api, refused=bad)) as runner:
        for other in others:
            assert api.wait_for(other)["attempts"] == 1
        wait_until(has_failed)
        assert runner.state.able
    failed = api.measurement(bad)
    assert (failed["failure"]["code"], failed["attempts"]) == ("internal_error", 3)


@pytest.mark.slow
def test_want_of_memory_or_descriptors_in_a_worker_counts_attempts(api: Any, grey_png: bytes) -> None:
    queued = queue_images(api, grey_png, "MEa")
    with runner_of(api):
        documents = [api.wait_for(measurement_id) for measurement_id in queued]
    ends = [(each["failure"]["code"], each["attempts"]) for each in documents]
    assert ends == [("worker_crashed", 3), ("internal_error", 3), ("target_not_found", 1)]


@pytest.mark.slow
@pytest.mark.postgres
def test_the_runner_takes_its_lock_again_after_its_connection_was_lost(
    open_api: Any, postgres_url: str, tmp_path: Path, grey_png: bytes
) -> None:
    """As after a restart of the database's server: every connection of the service is ended."""

    def holders() -> set[int]:
        with installation.database.read() as records:
            held = sa.text(
                "SELECT pid FROM pg_locks JOIN pg_database ON pg_database.oid = database "
                "WHERE locktype = 'advisory' AND datname = current_database() AND objid = :lock"
            )
            return set(records.scalars(held, {"lock": ADVISORY_LOCK}))

    with open_api(tmp_path / "data", database_url=postgres_url) as api:
        installation = api.installation
        with runner_of(api) as runner:
            wait_until(lambda: len(holders()) == 2)  # the runner's, and the one that listens for the service
            first = holders()
            for pid in first:
                with installation.database.write() as records:
                    records.execute(sa.text("SELECT pg_terminate_backend(:pid)"), {"pid": pid})
            wait_until(lambda: len(holders() - first) == 2)
            assert runner.alive
            with pytest.raises(AlreadyLocked), runner_of(api):
                pass
        assert len(holders()) == 1, "the service's own"


@pytest.mark.slow
def test_the_real_computation_is_ready_only_after_its_first_image(api: Any, own_workers: OwnWorkers) -> None:
    with runner_of(api, compute=process_image) as runner:
        wait_until(lambda: runner.state.ready == 1)
        (worker,) = own_workers()
        maps = Path(f"/proc/{worker}/maps").read_text()
    assert "cv2" in maps
