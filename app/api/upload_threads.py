"""Threads that store images: one step to a thread and one back, with nothing in between.

The framework's own way to a thread (`run_in_threadpool`) costs a small image a tenth of everything else.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from contextvars import copy_context
from queue import SimpleQueue
from typing import Any, TypeVar

Answer = TypeVar("Answer")
MAX_THREADS = 40


class _Call:
    """Work on its way to a thread and back; all but `run` belong to the event loop."""

    def __init__(self, work: Callable[[], Any]) -> None:
        self._work = work
        self._context = copy_context()  # who is acting
        self._loop = asyncio.get_running_loop()
        self._ended = False
        self._waiting: asyncio.Future[None] | None = None
        self.future: asyncio.Future[Any] = self._loop.create_future()

    def run(self) -> None:
        """Do the work in a thread and bring its end to the loop."""
        answer, error = None, None
        try:
            answer = self._context.run(self._work)
        except BaseException as raised:  # noqa: BLE001 - raised where the answer is awaited
            error = raised
        with suppress(RuntimeError):  # the loop has ended: nobody awaits it
            self._loop.call_soon_threadsafe(self._finish, answer, error)

    async def ended(self) -> None:
        """Return when the thread is done, however often this is cancelled."""
        while not self._ended:
            self._waiting = self._loop.create_future()
            with suppress(asyncio.CancelledError):
                await self._waiting

    def _finish(self, answer: Any, error: BaseException | None) -> None:
        self._ended = True
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)
        if self.future.done():  # cancelled
            return
        if error is None:
            self.future.set_result(answer)
        else:
            self.future.set_exception(error)


class UploadThreads:
    """Up to `most` threads, started as they are needed; for any number of event loops."""

    def __init__(self, most: int = MAX_THREADS) -> None:
        self._most = most
        self._calls: SimpleQueue[_Call] = SimpleQueue()
        self._lock = threading.Lock()
        self._threads = self._under_way = 0

    async def run(self, work: Callable[[], Answer]) -> Answer:
        """Return what `work` returns in a thread; raise what it raises.

        Who is cancelled meanwhile waits for its end: the work cannot be interrupted, and what it works on must stay.
        Raises RuntimeError where there is no thread and the system has none.
        """
        call = _Call(work)
        with self._lock:
            self._under_way += 1
        try:
            self._provide_thread()
            self._calls.put(call)
            try:
                answer: Answer = await call.future
            except asyncio.CancelledError:
                await call.ended()
                raise
            return answer
        finally:
            with self._lock:
                self._under_way -= 1

    def _provide_thread(self) -> None:
        """Start a thread where all of them may be busy; where the system has none, those that are there must do."""
        with self._lock:
            if self._threads >= min(self._under_way, self._most):
                return
            try:
                threading.Thread(target=self._work, name=f"upload-{self._threads}", daemon=True).start()
            except RuntimeError:
                if self._threads == 0:
                    raise
            else:
                self._threads += 1

    def _work(self) -> None:
        while True:
            call = self._calls.get()
            call.run()
            del call  # and with it the image's bytes, until the next one comes


THREADS = UploadThreads()
"""Those of this process."""
