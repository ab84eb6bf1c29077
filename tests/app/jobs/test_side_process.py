"""What becomes of a call whose process dies, hangs, grows, or is not wanted any more.

The processes are those that draw: the numerics take seconds to load.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.jobs.subprocess_executor import (
    Cancelled,
    Limits,
    OutOfMemory,
    ProcessDied,
    SubprocessExecutor,
    TimedOut,
    resident_bytes,
)
from app.jobs.worker_init import start_drawing

MIB = 1024 * 1024


@pytest.fixture(scope="module")
def process() -> Iterator[SubprocessExecutor]:
    process = SubprocessExecutor(1_000_000, Limits(60.0), start_drawing)
    yield process
    process.close()


@pytest.mark.slow
def test_a_call_runs_elsewhere(process: SubprocessExecutor) -> None:
    assert process.call(max, 2, 3) == 3
    assert process.call(os.getpid) != os.getpid()


@pytest.mark.slow
def test_the_next_call_survives_the_death_of_the_process(process: SubprocessExecutor) -> None:
    with pytest.raises(ProcessDied) as caught:
        process.call(os._exit, 3)
    assert type(caught.value) is ProcessDied
    assert process.call(max, 2, 3) == 3


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")
def test_a_process_killed_while_idle_is_replaced_and_no_call_fails(process: SubprocessExecutor) -> None:
    first = process.call(os.getpid)
    os.kill(first, signal.SIGKILL)
    assert process.call(os.getpid) != first


def test_what_a_function_raises_is_raised_here(process: SubprocessExecutor) -> None:
    with pytest.raises(ZeroDivisionError):
        process.call(divmod, 1, 0)
    assert process.call(max, 2, 3) == 3


def test_what_cannot_be_sent_back_is_an_error_and_not_a_death(process: SubprocessExecutor) -> None:
    before = process.call(os.getpid)
    with pytest.raises(RuntimeError, match="cannot be sent"):
        process.call(threading.Lock)
    assert process.call(os.getpid) == before


@pytest.mark.slow
def test_a_call_that_hangs_is_given_up() -> None:
    process = SubprocessExecutor(1_000_000, Limits(0.5), start_drawing)
    try:
        with pytest.raises(TimedOut):
            process.call(time.sleep, 60)
    finally:
        process.close()


def test_a_step_of_the_wall_clock_ends_no_call(
    process: SubprocessExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system's clock is replaced, none of our own code is."""
    true_time, steps = time.time, iter(range(1, 10_000))
    with monkeypatch.context() as clock:
        clock.setattr(time, "time", lambda: true_time() + 90.0 * next(steps))
        assert process.call(time.sleep, 0.3) is None


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc to see memory")
def test_a_call_that_grows_beyond_its_memory_is_ended_and_the_next_one_works() -> None:
    process = SubprocessExecutor(1_000_000, Limits(60.0, memory_bytes=600 * MIB), start_drawing)
    try:
        small = process.call(os.getpid)
        assert 0 < resident_bytes(small) < 600 * MIB
        with pytest.raises(OutOfMemory):
            process.call(hold, 900 * MIB)
        assert process.call(os.getpid) != small
        with pytest.raises(OutOfMemory):  # what the system refuses at once is the same to the caller
            process.call(bytearray, 2**62)
    finally:
        process.close()


@pytest.mark.slow
def test_a_cancelled_call_ends_its_process(process: SubprocessExecutor) -> None:
    before = process.call(os.getpid)
    cancelled = threading.Event()
    timer = threading.Timer(0.2, cancelled.set)
    timer.start()
    with pytest.raises(Cancelled):
        process.call(time.sleep, 300.0, cancelled=cancelled)
    timer.join()
    assert before not in {child.pid for child in multiprocessing.active_children()}
    assert process.call(max, 2, 3) == 3


def hold(size: int) -> None:
    """Take memory, and touch it, for as long as this process lives."""
    kept = bytearray(size)
    kept[::4096] = b"x" * len(kept[::4096])
    time.sleep(300.0)
