"""Processes alongside an application and its workers, lent to one after another: each start loads the numerics, seconds
of processor time.

What an application asks of them, and what ends them, is as ever: only its end leaves them to the next one.
"""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from app.jobs.subprocess_executor import Initialise, Limits, ProcessDied, SubprocessExecutor
from app.jobs.worker_process import WorkerProcess

Result = TypeVar("Result")

_NO_LIMITS = Limits(300.0)


class SideProcesses:
    """The processes that no application has just now, by what prepares them; the one last used is lent first.

    None is lent to an application with other variables in its environment, as those of an object store: a process has
    what was set when it started.
    """

    def __init__(self) -> None:
        self._free: dict[Any, list[_Lent]] = {}
        self._workers: dict[Any, list[_LentWorker]] = {}

    def lend(self, max_pixels: int, limits: Limits, initialise: Initialise) -> SubprocessExecutor:
        """Return one for an application that starts, whose end gives it back."""
        free = self._free.setdefault((max_pixels, initialise, _environment()), [])
        lent = free.pop() if free else _Lent(max_pixels, limits, initialise, free)
        lent.put_under(limits)
        return lent

    def lend_worker(self, initialise: Initialise, arguments: tuple[int, bool]) -> WorkerProcess:
        """Return a worker process for an application that starts, whose end gives it back if it is idle."""
        free = self._workers.setdefault((initialise, arguments, _environment()), [])
        while free:
            worker = free.pop()
            if worker.active:
                return worker
        return _LentWorker(initialise, (arguments[0], False), free)

    def close(self) -> None:
        """End those that no application has."""
        for worker in (worker for free in self._workers.values() for worker in free):
            worker.kill()
        self._workers.clear()
        for process in (process for free in self._free.values() for process in free):
            process.end()
        self._free.clear()


def _environment() -> frozenset[tuple[str, str]]:
    return frozenset((name, value) for name, value in os.environ.items() if not name.startswith("PYTEST_"))


class _Lent(SubprocessExecutor):
    def __init__(self, max_pixels: int, limits: Limits, initialise: Initialise, free: list[_Lent]) -> None:
        super().__init__(max_pixels, limits, _Untied(initialise))
        self._free = free
        self._is_used = False

    def put_under(self, limits: Limits) -> None:
        """Take the limits of another application, which has not called it yet."""
        self._limits, self._is_used = limits, False

    def call(
        self,
        function: Callable[..., Result],
        *arguments: Any,
        cancelled: threading.Event | None = None,
    ) -> Result:
        self._is_used = True
        return super().call(function, *arguments, cancelled=cancelled)

    def close(self) -> None:
        """Take it back from an application: it keeps nothing open of that one's data."""
        running = self._running
        self._limits = _NO_LIMITS
        if self._is_used and running is not None and running.ready and running.process.is_alive():
            with contextlib.suppress(ProcessDied):
                self.call(close_databases)
        self._free.append(self)

    def end(self) -> None:
        super().close()


class _LentWorker(WorkerProcess):
    """One that outlives the thread of the application that started it."""

    def __init__(self, initialise: Initialise, arguments: tuple[int, bool], free: list[_LentWorker]) -> None:
        super().__init__(initialise, arguments)
        self._free = free

    def end(self) -> None:
        with self._lock:
            is_idle = self._alive and self._awaited is None
        if is_idle:
            self._free.append(self)
        else:
            self.kill()

    def kill(self) -> None:
        super().end()


class _Untied:
    """Prepares a process that outlives the thread of the application that started it."""

    def __init__(self, initialise: Initialise) -> None:
        self._initialise = initialise

    def __call__(self, max_pixels: int, _: bool) -> None:
        self._initialise(max_pixels, False)


def close_databases() -> None:
    """Close the connections of the process in which this runs, as its end would."""
    worker = sys.modules.get("app.analyses.worker")
    if worker is not None and worker.open_database.cache_info().currsize:
        worker.open_database.cache_clear()
        gc.collect()
