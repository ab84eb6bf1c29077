"""One process behind a pipe: its answers, its errors, and its end."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from app.jobs.worker_process import ProcessExpired, WorkerProcess

WITHIN_S = 60.0


@contextmanager
def started(*arguments: object) -> Iterator[WorkerProcess]:
    process = WorkerProcess(_initialise, arguments)
    try:
        yield process
    finally:
        process.end()


def _initialise(*wrong: object) -> None:
    if wrong:
        raise ValueError(*wrong)


def _lock() -> object:
    return threading.Lock()  # which cannot be pickled


def test_answers_and_errors_come_back_and_the_process_goes_on() -> None:
    with started() as process:
        assert process.greeting.result(WITHIN_S) is None
        pid = process.schedule(os.getpid).result(WITHIN_S)
        with pytest.raises(FileNotFoundError) as raised:
            process.schedule(os.stat, "/no/such/file").result(WITHIN_S)
        assert "_serve" in raised.value.__notes__[0], "where it was raised"
        with pytest.raises(TypeError, match="lock"):
            process.schedule(_lock).result(WITHIN_S)
        assert process.schedule(os.getpid).result(WITHIN_S) == pid != os.getpid()


def test_a_failed_start_is_reported() -> None:
    with started("no") as process, pytest.raises(ValueError, match="no"):
        process.greeting.result(WITHIN_S)


def test_the_end_of_the_process_is_the_end_of_its_call() -> None:
    with started() as process:
        process.greeting.result(WITHIN_S)
        with pytest.raises(ProcessExpired) as raised:
            process.schedule(os._exit, 3).result(WITHIN_S)
        assert raised.value.exitcode == 3
        assert not process.active
        with pytest.raises(BrokenPipeError):
            process.schedule(os.getpid)
