"""Calls that wait for subprocesses, in turn over the requesters: none has more than half of them.

A share is of places and of processes: whoever keeps asking waits for itself, and the first call of another finds a
process at once or is the next to.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from app.jobs.subprocess_executor import Cancelled, Initialise, Limits, ProcessDied, SubprocessExecutor
from app.jobs.worker_init import start_worker
from app.logs import Logger

Result = TypeVar("Result")

log = Logger(__name__)


class QueueFull(Exception):
    """As many calls wait as may, or the system has no thread for this one."""


class ShareTaken(QueueFull):
    """As many calls of this requester wait as may; others still get in."""


@dataclass(eq=False)
class Call(Generic[Result]):
    """One call under way; `future` has its result, or Lost and its kinds, or what the function raised."""

    requester: str | None
    function: Callable[..., Result]
    arguments: tuple[Any, ...]
    future: Future[Result] = field(default_factory=Future)
    cancelled: threading.Event = field(default_factory=threading.Event)


class CallQueue:
    """Runs functions in `processes` subprocesses; at most `places` calls wait or run.

    A requester has at most half of either, and at least one; None is everyone together, without a share.
    """

    def __init__(
        self,
        max_pixels: int,
        *,
        processes: int,
        places: int,
        limits: Limits,
        initialise: Initialise = start_worker,
    ) -> None:
        self._processes, self._places = processes, places
        # The one last used is taken first: it is warm, and others need not be started.
        self._idle = [SubprocessExecutor(max_pixels, limits, initialise) for _ in range(processes)]
        self._waiting: OrderedDict[str | None, deque[Call[Any]]] = OrderedDict()
        self._running: set[Call[Any]] = set()
        self._threads: list[threading.Thread] = []
        self._changed = threading.Condition()
        self._closed = False

    def submit(self, requester: str | None, function: Callable[..., Result], *arguments: Any) -> Call[Result]:
        """Queue a call; raise ShareTaken or Crowded where there is no place, Lost once closed."""
        call = Call(requester, function, arguments)
        call.future.set_running_or_notify_cancel()  # of several who wait, none may cancel it for the others
        with self._changed:
            if self._closed:
                raise ProcessDied
            waiting = self._waiting.get(requester, ())
            if requester is not None and len(waiting) + self._runs(requester) >= max(1, self._places // 2):
                raise ShareTaken
            if self._count() >= self._places:
                raise QueueFull
            self._waiting.setdefault(requester, deque()).append(call)
            try:
                self._start_threads()
            except (
                RuntimeError
            ) as error:  # the system has no more; a thread that is there takes the call later
                log.warning("side_process_thread_not_started", threads=len(self._threads), error=repr(error))
                if not self._threads:
                    self._take(call)
                    raise QueueFull from error
            # Not notify: the one thread woken may be one that this requester's share does not let run it.
            self._changed.notify_all()
        return call

    def call(self, requester: str | None, function: Callable[..., Result], *arguments: Any) -> Result:
        """Return the result of a call; raises as `submit` and the call's future do."""
        return self.submit(requester, function, *arguments).future.result()

    def cancel(self, call: Call[Any]) -> None:
        """Drop a call that waits, end the process of one that runs; nothing happens to one that is over."""
        call.cancelled.set()
        with self._changed:
            waiting = self._waiting.get(call.requester, ())
            if call not in waiting:
                return
            self._take(call)
        call.future.set_exception(Cancelled())

    def counts(self) -> tuple[int, int]:
        """Return how many calls wait and how many run."""
        with self._changed:
            return self._count() - len(self._running), len(self._running)

    def interrupt(self) -> None:
        """Give up what is running and waiting, without waiting for its end."""
        with self._changed:
            calls = [*self._running, *(call for waiting in self._waiting.values() for call in waiting)]
        for call in calls:
            self.cancel(call)

    def close(self) -> None:
        """Give up everything and end the processes."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self.interrupt()
        for thread in self._threads:
            thread.join()
        for process in self._idle:
            try:
                process.close()
            except Exception:
                log.exception("side_process_not_ended")

    def _start_threads(self) -> None:
        """Start as many threads as calls can run at once; RuntimeError where the system has no more."""
        while len(self._threads) < min(self._count(), self._processes):
            thread = threading.Thread(target=self._work, name="side-process", daemon=True)
            thread.start()
            self._threads.append(thread)

    def _work(self) -> None:
        while (next_one := self._next()) is not None:
            call, process = next_one
            try:
                result = process.call(call.function, *call.arguments, cancelled=call.cancelled)
            except BaseException as error:  # noqa: BLE001 - raised where the result is awaited
                self._finish(call, process)
                call.future.set_exception(error)
            else:
                self._finish(call, process)
                call.future.set_result(result)

    def _next(self) -> tuple[Call[Any], SubprocessExecutor] | None:
        """Return the next call in turn, and what runs it, as soon as there is one; None once closed."""
        with self._changed:
            while not self._closed:
                for requester, waiting in self._waiting.items():
                    if requester is None or self._runs(requester) < max(1, self._processes // 2):
                        call = waiting[0]
                        self._take(call)
                        if requester in self._waiting:
                            self._waiting.move_to_end(requester)
                        self._running.add(call)
                        return call, self._idle.pop()
                self._changed.wait()
            return None

    def _finish(self, call: Call[Any], process: SubprocessExecutor) -> None:
        with self._changed:
            self._running.discard(call)
            self._idle.insert(len(self._idle) if process.is_warm else 0, process)
            self._changed.notify_all()

    def _take(self, call: Call[Any]) -> None:
        waiting = self._waiting[call.requester]
        waiting.remove(call)
        if not waiting:
            del self._waiting[call.requester]

    def _runs(self, requester: str) -> int:
        return sum(call.requester == requester for call in self._running)

    def _count(self) -> int:
        return len(self._running) + sum(map(len, self._waiting.values()))
