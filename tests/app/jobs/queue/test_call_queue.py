"""Who gets a process when more ask than there are; of processes without the numerics, which take seconds to load."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from app.jobs.call_queue import Call, CallQueue, QueueFull, ShareTaken
from app.jobs.subprocess_executor import Cancelled, Limits, ProcessDied
from app.jobs.worker_init import start_drawing


@pytest.fixture(scope="module")
def queue() -> Iterator[CallQueue]:
    queue = CallQueue(1_000_000, processes=2, places=6, limits=Limits(300.0), initialise=start_drawing)
    yield queue
    queue.close()


@pytest.fixture
def gate(tmp_path: Path) -> Iterator[Path]:
    """A file that calls wait for; it is there at the end in any case."""
    gate = tmp_path / "gate"
    yield gate
    gate.touch()


def await_file(gate: str, name: str) -> str:
    """Run in a side process: say by a file that it runs, and return once the gate is there."""
    Path(f"{gate}.{name}").touch()
    while not Path(gate).exists():
        time.sleep(0.01)
    return name


def running(gate: Path) -> set[str]:
    return {path.name.removeprefix("gate.") for path in gate.parent.glob("gate.*")}


def await_running(gate: Path, *names: str) -> None:
    deadline = time.monotonic() + 120.0
    while not set(names) <= running(gate):
        assert time.monotonic() < deadline, f"{names} never ran"
        time.sleep(0.01)


@pytest.mark.slow
def test_who_floods_the_queue_waits_for_itself_and_others_run_at_once(queue: CallQueue, gate: Path) -> None:
    flood: list[Call[Any]] = [queue.submit("a", await_file, str(gate), f"a{i}") for i in range(3)]
    with pytest.raises(ShareTaken):
        queue.submit("a", await_file, str(gate), "a3")
    await_running(gate, "a0")
    other = queue.submit("b", await_file, str(gate), "b0")
    await_running(gate, "b0")
    assert running(gate) == {"a0", "b0"}, "one process is enough for a key that asks three times"
    assert queue.counts() == (2, 2)
    gate.touch()
    assert [call.future.result(120.0) for call in (*flood, other)] == ["a0", "a1", "a2", "b0"]
    assert queue.counts() == (0, 0)


def test_requesters_take_turns(queue: CallQueue, gate: Path) -> None:
    blocking = [queue.submit(key, await_file, str(gate), f"{key}-first") for key in ("a", "b")]
    await_running(gate, "a-first", "b-first")
    next_gate = gate.parent / "next" / gate.name
    next_gate.parent.mkdir()
    later = [
        queue.submit(key, await_file, str(next_gate), name)
        for key, name in (("a", "a2"), ("a", "a3"), ("c", "c1"))
    ]
    gate.touch()
    await_running(next_gate, "a2", "c1")  # two processes: the third call, of a again, waits
    assert running(next_gate) == {"a2", "c1"}
    next_gate.touch()
    for call in (*blocking, *later):
        call.future.result(120.0)


def test_without_a_key_there_is_no_share_but_an_end_of_places(queue: CallQueue, gate: Path) -> None:
    calls = [queue.submit(None, await_file, str(gate), f"n{i}") for i in range(6)]
    with pytest.raises(QueueFull) as caught:
        queue.submit(None, max, 2, 3)
    assert not isinstance(caught.value, ShareTaken)
    await_running(gate, "n0", "n1")
    gate.touch()
    for call in calls:
        call.future.result(120.0)


def test_a_cancelled_call_that_waits_never_runs_and_one_that_runs_is_stopped(
    queue: CallQueue, gate: Path
) -> None:
    first, second = (queue.submit("a", await_file, str(gate), name) for name in ("first", "second"))
    await_running(gate, "first")
    queue.cancel(second)
    queue.cancel(first)
    for call in (first, second):
        with pytest.raises(Cancelled):
            call.future.result(120.0)
    assert queue.call("a", max, 2, 3) == 3
    assert running(gate) == {"first"}
    queue.cancel(first)  # over: nothing happens


def test_a_process_that_was_used_is_used_again(queue: CallQueue) -> None:
    assert len({queue.call("a", os.getpid) for _ in range(4)}) == 1


@pytest.mark.slow
def test_closing_lets_go_of_those_who_wait(gate: Path) -> None:
    before = set(threading.enumerate())
    queue = CallQueue(1_000_000, processes=1, places=8, limits=Limits(300.0), initialise=start_drawing)
    calls = [queue.submit(None, await_file, str(gate), f"n{i}") for i in range(3)]
    await_running(gate, "n0")
    queue.close()
    for call in calls:
        with pytest.raises(ProcessDied):
            call.future.result(30.0)
    with pytest.raises(ProcessDied):
        queue.submit(None, max, 2, 3)
    assert set(threading.enumerate()) <= before


@contextmanager
def no_threads() -> Iterator[None]:
    """As where the system has no thread left for a queue."""
    start = threading.Thread.start

    def refuse(thread: threading.Thread) -> None:
        if thread.name == "side-process":
            raise RuntimeError("can't start new thread")
        start(thread)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threading.Thread, "start", refuse)
        yield


@pytest.mark.slow
def test_a_call_that_finds_no_thread_is_refused_and_later_ones_run() -> None:
    queue = CallQueue(1_000_000, processes=2, places=8, limits=Limits(300.0), initialise=start_drawing)
    with no_threads(), pytest.raises(QueueFull):
        queue.submit("a", max, 2, 3)
    assert queue.counts() == (0, 0)
    assert queue.call("b", max, 2, 3) == 3
    queue.close()


@pytest.mark.slow
def test_threads_that_could_not_be_had_are_started_with_a_later_call(gate: Path) -> None:
    queue = CallQueue(1_000_000, processes=2, places=8, limits=Limits(300.0), initialise=start_drawing)
    first = queue.submit("a", await_file, str(gate), "first")
    with no_threads():
        second = queue.submit("b", await_file, str(gate), "second")
    third = queue.submit("c", await_file, str(gate), "third")
    await_running(gate, "first", "second")
    gate.touch()
    assert [call.future.result(120.0) for call in (first, second, third)] == ["first", "second", "third"]
    queue.close()


def test_a_queue_that_never_had_a_thread_can_be_closed() -> None:
    queue = CallQueue(1_000_000, processes=1, places=8, limits=Limits(300.0), initialise=start_drawing)
    with no_threads(), pytest.raises(QueueFull):
        queue.submit(None, max, 2, 3)
    queue.close()
