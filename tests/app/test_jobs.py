"""The queue and its runner: nothing lost, nothing twice, one job's death nobody else's."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from app.jobs.embedded import EmbeddedRunner
from app.jobs.queue import Finished, Job
from app.jobs.runner_lock import RunnerLock
from app.records.codec import Failure, Outcome
from app.records.lock import AlreadyLocked

DONE = Outcome(result=None, failure=Failure("target_not_found", "Nothing there.", None))
SECONDS = 120.0


def compute_by_name(job: Job, path: str, _max_pixels: int) -> tuple[Outcome, float]:
    """A computation that does what the image's last byte says: die, hang, raise, or end well."""
    order = Path(path).read_bytes()[-1:]
    if order == b"K":
        os.kill(os.getpid(), signal.SIGKILL)
    if order == b"T":
        os.kill(os.getpid(), signal.SIGTERM)
        signal.pause()
    if order == b"H":
        signal.pause()
    if order == b"R":
        raise RuntimeError("a defect")
    return DONE, 1.0


def descendants(pid: int) -> list[int]:
    """Return the processes that `pid` and its children started."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text().split():
            found += [int(child), *descendants(int(child))]
    return found


def command_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except FileNotFoundError:
        return b""


def is_alive(pid: int) -> bool:
    """Tell whether a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + SECONDS
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)


@contextmanager
def runner_of(api: Any, **options: Any) -> Iterator[EmbeddedRunner]:
    installation = api.installation
    values: dict[str, Any] = {"workers": 1, "timeout_s": 60.0, "compute": compute_by_name, **options}
    runner = EmbeddedRunner(
        installation.queue,
        installation.blobs,
        RunnerLock(installation.settings.data_dir, installation.database),
        max_pixels=1_000_000,
        **values,
    )
    runner.start()
    try:
        yield runner
    finally:
        runner.stop()


def queue_images(api: Any, grey_png: bytes, orders: str) -> list[str]:
    session_id = api.make_session()
    ids = []
    for number, order in enumerate(orders):
        response = api.put_image(session_id, grey_png + b"%d" % number + order.encode())
        assert response.status_code == 202, response.text
        ids.append(response.json()["id"])
    return ids


def test_claims_are_oldest_first_and_exclusive(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    ids = queue_images(any_api, grey_png, "abcde")
    first, second, third = queue.claim(2), queue.claim(2), queue.claim(2)
    assert [job.measurement_id for job in (*first, *second, *third)] == ids
    assert queue.claim(2) == ()
    assert any_api.client.get(f"/v1/measurements/{ids[0]}").json()["status"] == "running"
    assert [sought.fields["columns"] for sought in first[0].targets] == [9]
    assert first[0].names_its_target
    running = any_api.client.post(f"/v1/measurements/{ids[0]}/retry")
    assert (running.status_code, running.json()["code"]) == (409, "measurement_running")


def test_a_result_is_written_once_and_only_by_the_current_claim(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    (measurement_id,) = queue_images(any_api, grey_png, "a")
    (stale,) = queue.claim(1)
    assert queue.recover() == 1
    (current,) = queue.claim(1)
    assert queue.finish([Finished(stale, DONE, 1.0)]) == 0
    assert any_api.client.get(f"/v1/measurements/{measurement_id}").json()["status"] == "running"
    assert queue.finish([Finished(current, DONE, 1.0), Finished(current, DONE, 2.0)]) == 1
    document = any_api.client.get(f"/v1/measurements/{measurement_id}").json()
    assert (document["status"], document["attempts"], document["duration_ms"]) == ("failed", 1, 1.0)


def test_a_result_of_a_deleted_session_is_dropped(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    (measurement_id,) = queue_images(any_api, grey_png, "a")
    (job,) = queue.claim(1)
    session_id = any_api.client.get(f"/v1/measurements/{measurement_id}").json()["session_id"]
    assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert queue.finish([Finished(job, DONE, 1.0)]) == 0


def test_three_crashes_are_the_end_and_a_restart_counts_none(any_api: Any, grey_png: bytes) -> None:
    queue = any_api.installation.queue
    (measurement_id,) = queue_images(any_api, grey_png, "a")

    def document() -> dict[str, Any]:
        answer: dict[str, Any] = any_api.client.get(f"/v1/measurements/{measurement_id}").json()
        return answer

    for attempt in (1, 2):
        queue.claim(1)
        queue.recover()
        (job,) = queue.claim(1)
        queue.give_back([job])
        (job,) = queue.claim(1)
        queue.crashed(job)
        queue.crashed(job)
        assert (document()["status"], document()["attempts"]) == ("queued", attempt)
    (job,) = queue.claim(1)
    queue.crashed(job)
    assert (document()["status"], document()["attempts"]) == ("failed", 3)
    assert document()["failure"]["code"] == "worker_crashed"
    assert document()["failure"]["advice"]
    retried = any_api.client.post(f"/v1/measurements/{measurement_id}/retry").json()
    assert (retried["status"], retried["attempts"], retried["failure"]) == ("queued", 0, None)


def test_a_poison_image_fails_after_three_attempts_and_harms_nobody(api: Any, grey_png: bytes) -> None:
    ids = queue_images(api, grey_png, "aKbcR")
    with runner_of(api, workers=2) as runner:
        documents = [api.wait_for(measurement_id) for measurement_id in ids]
        assert runner.alive
        assert runner.crashes == 3
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


def test_a_job_that_hangs_is_ended_and_the_next_one_runs(api: Any, grey_png: bytes) -> None:
    ids = queue_images(api, grey_png, "Ha")
    with runner_of(api, timeout_s=0.5) as runner:
        hung, fine = (api.wait_for(measurement_id) for measurement_id in ids)
        assert runner.timeouts == 1
    assert (hung["failure"]["code"], hung["attempts"]) == ("processing_timeout", 1)
    assert "0.5 s" in hung["failure"]["detail"]
    assert fine["failure"]["code"] == "target_not_found"


def test_stopping_gives_running_jobs_back_without_counting(api: Any, grey_png: bytes) -> None:
    ids = queue_images(api, grey_png, "HTaaaaaa")
    with runner_of(api, workers=2):
        wait_until(lambda: api.client.get(f"/v1/measurements/{ids[1]}").json()["status"] == "running")
        started = time.monotonic()
    assert time.monotonic() - started < 25.0
    left = [api.client.get(f"/v1/measurements/{measurement_id}").json() for measurement_id in ids]
    assert left[0]["status"] == "queued"
    assert left[0]["attempts"] == 0
    assert {document["status"] for document in left} <= {"queued", "failed"}
    with runner_of(api) as runner:
        assert runner.alive


def test_a_worker_killed_while_idle_costs_nothing(api: Any, grey_png: bytes) -> None:
    with runner_of(api) as runner:
        first = queue_images(api, grey_png, "a")[0]
        assert api.wait_for(first)["attempts"] == 1
        (worker,) = (pid for pid in descendants(os.getpid()) if b"spawn_main" in command_of(pid))
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


def test_one_database_has_one_runner_even_from_two_folders(
    open_api: Any, postgres_url: str, tmp_path: Path
) -> None:
    with (
        open_api(tmp_path / "one", database_url=postgres_url) as one,
        open_api(tmp_path / "two", database_url=postgres_url) as two,
        runner_of(one),
        pytest.raises(AlreadyLocked),
        runner_of(two),
    ):
        pass


HEAD = """
import pathlib, sys
sys.path[:0] = {path!r}
from app.services.installation import Installation
from app.settings import Settings
if __name__ == "__main__":
    installation = Installation.open(Settings(data_dir=pathlib.Path({data_dir!r}), workers=2))
    runner = installation.runner()
    runner.start()
    print("started", flush=True)
    sys.stdin.read()
"""


def test_workers_die_with_a_head_that_was_killed_and_free_the_lock(api: Any, tmp_path: Path) -> None:
    data_dir = api.installation.settings.data_dir
    script = tmp_path / "head.py"
    script.write_text(HEAD.format(path=sys.path, data_dir=str(data_dir)))
    with subprocess.Popen(
        [sys.executable, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as head:
        assert head.stdout is not None
        assert head.stdout.readline() == b"started\n"
        wait_until(lambda: sum(b"spawn_main" in command_of(pid) for pid in descendants(head.pid)) >= 2)
        children = descendants(head.pid)
        with pytest.raises(AlreadyLocked), runner_of(api):
            pass
        head.kill()
        head.wait()
    deadline = time.monotonic() + 15
    while alive := [pid for pid in children if is_alive(pid)]:
        assert time.monotonic() < deadline, f"{len(alive)} processes outlived the head by 15 s"
        time.sleep(0.05)
    with runner_of(api) as runner:
        assert runner.alive
