"""The queue and its runner: nothing lost, nothing twice, one job's death nobody else's."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from app.jobs.queue import JobResult
from app.jobs.queue.sql_queue import SqlQueue
from app.jobs.settlement import WORKER_CRASHED
from app.records.file_lock import AlreadyLocked
from app.records.presence import RunnerLock
from tests.support.environment.processes import OwnWorkers, descendants, is_alive, worker_processes
from tests.support.jobs.computations import DONE
from tests.support.jobs.runners import queue_images, runner_of
from tests.support.service.service import wait_until


def test_claims_are_oldest_first_and_exclusive(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    ids = queue_images(any_api, grey_png, "abcde")
    first, second, third = queue.claim(2), queue.claim(2), queue.claim(2)
    assert [job.measurement_id for job in (*first, *second, *third)] == ids
    assert queue.claim(2) == ()
    assert any_api.client.get(f"/v1/measurements/{ids[0]}").json()["status"] == "running"
    assert [sought.fields["columns"] for sought in first[0].targets] == [9]
    assert first[0].has_explicit_target
    running = any_api.client.post(f"/v1/measurements/{ids[0]}/retry")
    assert (running.status_code, running.json()["code"]) == (409, "measurement_in_progress")


def test_a_result_is_written_once_and_only_by_the_current_claim(any_api: Any, grey_png: bytes) -> None:
    queue = SqlQueue(any_api.installation.database)
    (measurement_id,) = queue_images(any_api, grey_png, "a")
    (stale,) = queue.claim(1)
    assert queue.recover() == 1
    (current,) = queue.claim(1)
    assert queue.finish([JobResult(stale, DONE, 1.0)]) == 0
    assert any_api.client.get(f"/v1/measurements/{measurement_id}").json()["status"] == "running"
    assert queue.finish([JobResult(current, DONE, 1.0), JobResult(current, DONE, 2.0)]) == 1
    document = any_api.client.get(f"/v1/measurements/{measurement_id}").json()
    assert (document["status"], document["attempts"], document["duration_ms"]) == ("failed", 1, 1.0)


def test_a_result_of_a_deleted_session_is_dropped(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    (measurement_id,) = queue_images(any_api, grey_png, "a")
    (job,) = queue.claim(1)
    session_id = any_api.client.get(f"/v1/measurements/{measurement_id}").json()["session_id"]
    assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert queue.finish([JobResult(job, DONE, 1.0)]) == 0


def test_three_crashes_are_the_end_and_a_restart_counts_none(any_api: Any, grey_png: bytes) -> None:
    queue = SqlQueue(any_api.installation.database)
    (measurement_id,) = queue_images(any_api, grey_png, "a")

    def document() -> dict[str, Any]:
        answer: dict[str, Any] = any_api.client.get(f"/v1/measurements/{measurement_id}").json()
        return answer

    for attempt in (1, 2):
        queue.claim(1)
        queue.recover()
        (job,) = queue.claim(1)
        queue.release([job])
        (job,) = queue.claim(1)
        queue.attempt_failed(job, WORKER_CRASHED, max_attempts=3)
        queue.attempt_failed(job, WORKER_CRASHED, max_attempts=3)
        assert (document()["status"], document()["attempts"]) == ("queued", attempt)
    (job,) = queue.claim(1)
    queue.attempt_failed(job, WORKER_CRASHED, max_attempts=3)
    assert (document()["status"], document()["attempts"]) == ("failed", 3)
    assert document()["failure"]["code"] == "worker_crashed"
    assert document()["failure"]["advice"]
    retried = any_api.client.post(f"/v1/measurements/{measurement_id}/retry").json()
    assert (retried["status"], retried["attempts"], retried["failure"]) == ("queued", 0, None)


@pytest.mark.slow
def test_a_poison_image_fails_after_three_attempts_and_harms_nobody(api: Any, grey_png: bytes) -> None:
    ids = queue_images(api, grey_png, "aKbcR")
    with runner_of(api, workers=2) as runner:
        documents = [api.wait_for(measurement_id) for measurement_id in ids]
        assert runner.alive
        wait_until(lambda: runner.settlement.crashes == 3)
    codes = [document["failure"]["code"] for document in documents]
    assert codes == [
        "target_not_found",
        "worker_crashed",
        "target_not_found",
        "target_not_found",
        "internal_error",
    ]
    assert [document["attempts"] for document in documents] == [1, 3, 1, 1, 1]
    assert "defect" not in documents[4]["failure"]["detail"]


@pytest.mark.slow
def test_a_job_that_hangs_is_ended_and_the_next_one_runs(api: Any, grey_png: bytes) -> None:
    ids = queue_images(api, grey_png, "Ha")
    with runner_of(api, timeout_s=2.0) as runner:
        hung, fine = (api.wait_for(measurement_id) for measurement_id in ids)
        wait_until(lambda: runner.settlement.timeouts == 2)
    assert (hung["failure"]["code"], hung["attempts"]) == ("processing_timeout", 2)
    assert fine["failure"]["code"] == "target_not_found"


def test_stopping_gives_running_jobs_back_without_counting(api: Any, grey_png: bytes) -> None:
    ids = queue_images(api, grey_png, "HTaaaaaa")
    with runner_of(api, workers=2):
        wait_until(lambda: api.client.get(f"/v1/measurements/{ids[1]}").json()["status"] == "running")
    left = [api.client.get(f"/v1/measurements/{measurement_id}").json() for measurement_id in ids]
    assert left[0]["status"] == "queued"
    assert left[0]["attempts"] == 0
    assert {document["status"] for document in left} <= {"queued", "failed"}
    with runner_of(api) as runner:
        assert runner.alive


@pytest.mark.slow
def test_a_worker_killed_while_idle_costs_nothing(api: Any, grey_png: bytes, own_workers: OwnWorkers) -> None:
    with runner_of(api) as runner:
        first = queue_images(api, grey_png, "a")[0]
        assert api.wait_for(first)["attempts"] == 1
        (worker,) = own_workers()
        os.kill(worker, signal.SIGKILL)
        later = queue_images(api, grey_png, "bcd")
        for measurement_id in later:
            assert api.wait_for(measurement_id)["failure"]["code"] == "target_not_found"
        assert runner.alive


def test_only_one_runner_works_on_a_data_folder(any_api: Any) -> None:
    with runner_of(any_api), pytest.raises(AlreadyLocked), runner_of(any_api):
        pass
    with runner_of(any_api) as runner:
        assert runner.alive


@pytest.mark.slow
def test_a_database_in_use_by_several_runners_is_nobodys_alone(
    open_api: Any, postgres_url: str, tmp_path: Path
) -> None:
    """Both folders hold the installation's id and pepper, as copies of one do."""
    with open_api(tmp_path / "one", database_url=postgres_url) as one:
        (tmp_path / "two").mkdir()
        for name in ("installation.json", "key-pepper"):
            shutil.copy(tmp_path / "one" / name, tmp_path / "two")
        with open_api(tmp_path / "two", database_url=postgres_url) as two, runner_of(one), runner_of(two):
            alone = RunnerLock(tmp_path / "three", two.installation.database, alone=True)
            (tmp_path / "three").mkdir()
            with pytest.raises(AlreadyLocked):
                alone.acquire()


HEAD = """
import pathlib, sys
sys.path[:0] = {path!r}
from app.services.installation.context import ServiceContext
from app.settings import Settings
if __name__ == "__main__":
    installation = ServiceContext.open(Settings(data_dir=pathlib.Path({data_dir!r}), workers=2))
    runner = installation.runner()
    runner.start()
    print("started", flush=True)
    sys.stdin.read()
"""


@pytest.mark.slow
def test_workers_die_with_a_head_that_was_killed_and_free_the_lock(api: Any, tmp_path: Path) -> None:
    data_dir = api.installation.settings.data_dir
    script = tmp_path / "head.py"
    script.write_text(HEAD.format(path=sys.path, data_dir=str(data_dir)))
    with subprocess.Popen(
        [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as head:
        assert head.stdout is not None
        assert head.stdout.readline() == b"started\n"
        wait_until(lambda: len(worker_processes(head.pid)) >= 2)
        children = descendants(head.pid)
        with pytest.raises(AlreadyLocked), runner_of(api):
            pass
        head.kill()
        head.wait()
    wait_until(lambda: not any(is_alive(pid) for pid in children), 120.0, "the head's processes end with it")
    with runner_of(api) as runner:
        assert runner.alive
