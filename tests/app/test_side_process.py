"""What becomes of a request whose process dies, hangs, or has too much to do."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from app.jobs.side_process import Crowded, Lost, SideProcess, TimedOut


@pytest.fixture(scope="module")
def process() -> Iterator[SideProcess]:
    process = SideProcess(1_000_000, timeout_s=30.0, waiting_at_most=2)
    yield process
    process.close()


def test_a_call_runs_elsewhere(process: SideProcess) -> None:
    assert process.call(max, 2, 3) == 3
    assert process.call(os.getpid) != os.getpid()


def test_the_next_call_survives_the_death_of_the_process(process: SideProcess) -> None:
    with pytest.raises(Lost) as told:
        process.call(os._exit, 3)
    assert not isinstance(told.value, TimedOut)
    assert process.call(max, 2, 3) == 3


def test_a_process_killed_while_idle_is_replaced(process: SideProcess) -> None:
    first = process.call(os.getpid)
    os.kill(first, 9)
    deadline = time.monotonic() + 30.0
    while True:
        try:
            assert process.call(os.getpid) != first
            return
        except Lost:  # at most the one call that meets the dead process
            assert time.monotonic() < deadline


def test_what_a_function_raises_is_raised_here(process: SideProcess) -> None:
    with pytest.raises(ZeroDivisionError):
        process.call(divmod, 1, 0)


def test_a_call_that_hangs_is_given_up() -> None:
    process = SideProcess(1_000_000, timeout_s=0.5, waiting_at_most=1)
    try:
        with pytest.raises(TimedOut):
            process.call(time.sleep, 60)
    finally:
        process.close()


def test_only_so_many_may_wait(process: SideProcess) -> None:
    def sleep() -> None:
        while True:
            try:
                return process.call(time.sleep, 1.0)
            except Crowded:  # by the question below
                time.sleep(0.01)

    with ThreadPoolExecutor(2) as pool:
        waiting = [pool.submit(sleep) for _ in range(2)]
        refused = 0
        while not all(one.done() for one in waiting):
            try:
                process.call(max, 2, 3)
            except Crowded:
                refused += 1
                time.sleep(0.01)
        for one in waiting:
            one.result()
    assert refused > 0


def test_closing_lets_go_of_those_who_wait() -> None:
    process = SideProcess(1_000_000, timeout_s=300.0, waiting_at_most=2)
    process.call(max, 2, 3)
    with ThreadPoolExecutor(2) as pool:
        waiting = [pool.submit(process.call, time.sleep, 200.0) for _ in range(2)]
        deadline = time.monotonic() + 10.0
        while not all(one.running() for one in waiting) and time.monotonic() < deadline:
            time.sleep(0.01)
        time.sleep(0.5)  # until the first of them is in the process
        process.close()
        for one in waiting:
            with pytest.raises(Lost):
                one.result(timeout=30.0)
