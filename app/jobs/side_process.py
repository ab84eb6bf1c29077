"""One process beside the head for what a request waits for: pictures and analyses never hold up uploads or events.

A call that crashes or outlasts its time ends its process, which is replaced; the request gets an error that says so,
and the next call finds everything in order.
"""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as FutureTimeout
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

import structlog
from pebble import ProcessExpired, ProcessPool

from app.jobs.worker_process import prepare_environment, start_worker

Result = TypeVar("Result")

log = structlog.get_logger(__name__)


class Crowded(Exception):
    """As many calls wait as may."""


class Lost(Exception):
    """The process died, or was ended, before it answered."""


class TimedOut(Lost):
    """The call took longer than it may, and its process was ended."""


class SideProcess:
    """Runs functions, one at a time, in a process started at the first call and replaced when it dies."""

    def __init__(self, max_pixels: int, *, timeout_s: float, waiting_at_most: int) -> None:
        self._max_pixels = max_pixels
        self._timeout_s = timeout_s
        self._pool: ProcessPool | None = None
        self._opening = threading.Lock()
        self._places = threading.BoundedSemaphore(waiting_at_most)
        self._waiting: set[Future[Any]] = set()

    def call(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Return what `function` returns in the process; raise Crowded, TimedOut or Lost."""
        if not self._places.acquire(blocking=False):
            raise Crowded
        pool = future = None
        try:
            pool = self._running_pool()
            future = pool.schedule(function, args=arguments, timeout=self._timeout_s)
            self._waiting.add(future)
            result: Result = future.result()
        except FutureTimeout as error:
            raise TimedOut from error
        except ProcessExpired as error:
            raise Lost from error  # that process alone; the pool starts another
        except (BrokenProcessPool, CancelledError, RuntimeError) as error:
            self._abandon(pool)
            raise Lost from error
        except Exception as error:
            # Only the process that failed knows where; what it sent along as text would be lost with it.
            log.error(
                "side_process_failed", function=function.__name__, trace=getattr(error, "traceback", None)
            )
            raise
        finally:
            self._waiting.discard(future)
            self._places.release()
        return result

    def close(self) -> None:
        """End the process; calls that wait for it are Lost."""
        # A pool that is stopped leaves the futures of what was running unanswered for ever.
        self.interrupt()
        self._abandon(self._pool)

    def interrupt(self) -> None:
        """Give up what is running and waiting, without waiting for its end."""
        for future in tuple(self._waiting):
            future.cancel()

    def _running_pool(self) -> ProcessPool:
        with self._opening:
            if self._pool is None:
                prepare_environment(self._max_pixels)
                # Not tied to this thread, which serves one request and may end long before the pool.
                self._pool = ProcessPool(
                    max_workers=1,
                    max_tasks=200,
                    initializer=start_worker,
                    initargs=(self._max_pixels, False),
                    context=multiprocessing.get_context("spawn"),
                )
            return self._pool

    def _abandon(self, pool: ProcessPool | None) -> None:
        """End a pool that no longer works, unless another request has done so already."""
        with self._opening:  # ended twice at once, a pool closes what is no longer its own
            if pool is None or self._pool is not pool:
                return
            self._pool = None
            pool.stop()  # type: ignore[no-untyped-call]
            pool.join()
