"""One process alongside the head for what a request waits for: drawings and analyses never hold up uploads or events.

A call that crashes, outlasts its time, outgrows its memory or is cancelled ends its process, and the next call starts
another. Time is measured by the monotonic clock, from the moment the process has taken the call.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, TypeVar

from app.jobs.worker_init import prepare_environment, start_worker
from app.logs import Logger

Result = TypeVar("Result")
Initialise = Callable[[int, bool], None]
"""Prepares the process, as `start_worker` does."""

START_WITHIN_S = 300.0
"""A first start may have to compile the kernels."""
MAX_CALLS = 200
"""After so many a process is replaced, so that what it leaks does not add up."""
_LOOK_EVERY_S = 0.05
_TAKEN = (True, None, "")
"""What a process says once it is ready, and of every call that has reached it."""

log = Logger(__name__)


class ProcessDied(Exception):
    """The process died, or was ended, before it answered."""


class TimedOut(ProcessDied):
    """The call took longer than it may, and its process was ended."""


class OutOfMemory(ProcessDied):
    """The call took more memory than it may."""


class Cancelled(ProcessDied):
    """Nobody waits for the call any more, and its process was ended."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What one call may take: seconds, and resident bytes where the system reports them (Linux)."""

    time_s: float
    memory_bytes: int | None = None


@dataclass(slots=True)
class _Running:
    process: SpawnProcess
    connection: Connection
    ready: bool = False
    calls: int = 0


class SubprocessExecutor:
    """Runs functions, one at a time, in a process started at the first call and replaced when it ends.

    `initialise` prepares the process; the default loads the numerics.
    """

    def __init__(self, max_pixels: int, limits: Limits, initialise: Initialise = start_worker) -> None:
        self._max_pixels = max_pixels
        self._initialise = initialise
        self._limits = limits
        self._running: _Running | None = None
        self._one_at_a_time = threading.Lock()

    def call(
        self,
        function: Callable[..., Result],
        *arguments: Any,
        cancelled: threading.Event | None = None,
    ) -> Result:
        """Return what `function` returns in the process, or raise what it raises.

        Raises TimedOut, OutOfMemory, Cancelled once `cancelled` is set, or Lost.
        """
        cancelled = cancelled or threading.Event()
        with self._one_at_a_time:
            try:
                running = self._send(function, arguments, cancelled)
                deadline = time.monotonic() + self._limits.time_s
                done, answer, trace = self._receive(running, deadline, cancelled, self._limits.memory_bytes)
            except BaseException as error:
                # Nothing of the call has reached a process that is still starting: the next call can have it.
                if not isinstance(error, Cancelled) or self._running is None or self._running.ready:
                    self._end()
                raise
            self._retire_if_worn(running)
        if done:
            result: Result = answer
            return result
        if isinstance(answer, MemoryError):
            raise OutOfMemory from answer
        # Only the process that failed knows where; what it sent along as text would be lost with it.
        log.error("side_process_failed", function=getattr(function, "__name__", "?"), trace=trace)
        raise answer

    @property
    def is_warm(self) -> bool:
        """Whether a process is there, so that a call need not wait for one to start."""
        return self._running is not None

    def close(self) -> None:
        """End the process; no call may be under way."""
        with self._one_at_a_time:
            self._end()

    def _send(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], cancelled: threading.Event
    ) -> _Running:
        """Return the process that has taken the call: one that died while idle is replaced."""
        for is_last in (False, True):
            running = self._started(cancelled)
            try:
                running.connection.send((function, arguments))
                self._receive(running, time.monotonic() + START_WITHIN_S, cancelled, None)
            except (TimedOut, Cancelled):
                raise
            except (OSError, ProcessDied) as error:
                self._end()
                if is_last:
                    raise ProcessDied from error
            else:
                break
        running.calls += 1
        return running

    def _started(self, cancelled: threading.Event) -> _Running:
        """Return a process that is ready; start one if none is alive."""
        running = self._running
        if running is None or not running.process.is_alive():
            self._end()
            running = self._start()
        if not running.ready:
            self._receive(running, time.monotonic() + START_WITHIN_S, cancelled, None)
            running.ready = True
        return running

    def _start(self) -> _Running:
        prepare_environment(self._max_pixels)
        context = multiprocessing.get_context("spawn")
        try:
            ours, theirs = context.Pipe()
            process = context.Process(
                target=_serve,
                args=(theirs, self._initialise, self._max_pixels),
                name="gridpose-side-process",
                daemon=True,
            )
            self._running = _Running(process, ours)
            try:
                process.start()
            finally:
                theirs.close()
        except OSError as error:  # descriptors, memory or processes are short; the next call tries again
            raise ProcessDied from error
        return self._running

    def _receive(
        self, running: _Running, deadline: float, cancelled: threading.Event, memory_bytes: int | None
    ) -> tuple[bool, Any, str]:
        process, connection = running.process, running.connection
        while True:
            if connection in wait([connection, process.sentinel], timeout=_LOOK_EVERY_S):
                try:
                    answer: tuple[bool, Any, str] = connection.recv()
                except (EOFError, OSError) as error:
                    raise ProcessDied from error
                return answer
            if not process.is_alive():
                raise ProcessDied(f"exit code {process.exitcode}")
            if cancelled.is_set():
                raise Cancelled
            if time.monotonic() > deadline:
                raise TimedOut
            if memory_bytes is not None and resident_bytes(process.pid) > memory_bytes:
                raise OutOfMemory

    def _retire_if_worn(self, running: _Running) -> None:
        """End a process that ran its calls, or holds on to so much memory that the next call would have too little."""
        limit = self._limits.memory_bytes
        if running.calls >= MAX_CALLS or (
            limit is not None and resident_bytes(running.process.pid) > limit // 2
        ):
            self._end()

    def _end(self) -> None:
        running, self._running = self._running, None
        if running is None:
            return
        running.connection.close()
        if running.process.pid is not None:  # it was started
            running.process.kill()
            running.process.join()
        running.process.close()


def resident_bytes(pid: int | None) -> int:
    """Return how much memory a process has resident; 0 where the system does not report it."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    except (OSError, IndexError):  # not Linux, or it ended meanwhile
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def _serve(calls: Connection, initialise: Initialise, max_pixels: int) -> None:
    """Run in the process: answer calls until the head closes the connection."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's; the head ends this process itself
    # The thread that calls lives as long as its queue does.
    initialise(max_pixels, True)
    _answer(calls, _TAKEN)
    while True:
        try:
            function, arguments = calls.recv()
            _answer(calls, _TAKEN)
        except (EOFError, OSError):
            return
        except Exception as error:  # noqa: BLE001 - what cannot be read here is for the caller to know
            _answer(calls, _TAKEN)
            _answer(calls, (False, error, traceback.format_exc()))
            continue
        try:
            answer = (True, function(*arguments), "")
        except Exception as error:  # noqa: BLE001 - raised again in the head
            answer = (False, error, traceback.format_exc())
        _answer(calls, answer)


def _answer(calls: Connection, answer: tuple[bool, Any, str]) -> None:
    try:
        calls.send(answer)
    except OSError:  # the head is gone or has given up
        os._exit(1)
    except Exception:  # noqa: BLE001 - the value cannot be sent, and the caller must know
        text = traceback.format_exc()
        calls.send((False, RuntimeError("the answer cannot be sent between processes"), text))
