"""One process that computes, a call at a time: a pipe, and a thread here that waits for its answers."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from multiprocessing.connection import Connection
from typing import Any

_REAP_S = 5.0
"""How long a process whose pipe is closed may take to be gone."""


class ProcessExpired(Exception):
    """The process ended before it answered; `exitcode` is as `multiprocessing` states it, None where nobody knows."""

    def __init__(self, exitcode: int | None) -> None:
        super().__init__(f"The process ended with exit code {exitcode}.")
        self.exitcode = exitcode


class WorkerProcess:
    """A process that runs `initialise(*arguments)`, and then what `schedule` gives it.

    `greeting` is done when the process is initialised. The thread that makes the process must outlive it: Linux ends
    the process together with that thread (`worker_init`). Raises OSError, RuntimeError where none can be started.
    """

    def __init__(self, initialise: Callable[..., None], arguments: tuple[Any, ...]) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, initialise, arguments), name="gridpose-worker", daemon=True
        )
        self._lock = threading.Lock()
        self._alive = True
        self.greeting: Future[None] = Future()
        self._awaited: Future[Any] | None = self.greeting
        self._listener = threading.Thread(target=self._listen, name="worker-answers", daemon=True)
        try:
            with contextlib.closing(theirs):
                self._process.start()
            self._listener.start()
        except BaseException:
            if self._process.pid is not None:
                self._process.kill()
            self._connection.close()
            raise

    @property
    def active(self) -> bool:
        """Whether the process is there, as far as is known."""
        return self._alive

    def schedule(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Begin a call; the process has answered the one before. Raises BrokenPipeError where it has ended."""
        future: Future[Any] = Future()
        with self._lock:
            if not self._alive:
                raise BrokenPipeError
            self._connection.send((function, arguments))
            self._awaited = future
        return future

    def end(self) -> None:
        """End the process, whatever it does; returns when it is gone."""
        self._process.kill()
        self._listener.join()

    def _listen(self) -> None:
        while True:
            try:
                done, answer = self._connection.recv()
            except (EOFError, OSError):
                break
            except Exception as error:  # noqa: BLE001 - an answer that cannot be read is that call's end
                done, answer = False, error
            self._answer(done, answer)
        self._process.join(_REAP_S)
        with self._lock:
            self._alive = False
            self._connection.close()
        self._answer(False, ProcessExpired(self._process.exitcode))

    def _answer(self, done: bool, answer: Any) -> None:
        with self._lock:
            future, self._awaited = self._awaited, None
        if future is None:
            return
        if done:
            future.set_result(answer)
        else:
            future.set_exception(answer)


def _serve(connection: Connection, initialise: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    """Answer calls until the pipe ends; runs in the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the service's
    function: Callable[..., Any] = initialise
    while True:
        try:
            answer = True, function(*arguments)
        except Exception as error:  # noqa: BLE001 - raised where the answer is awaited
            error.add_note("".join(traceback.format_exception(error)))
            answer = False, error
        try:
            connection.send(answer)
        except OSError:
            return
        except Exception as error:  # noqa: BLE001 - it cannot be pickled
            connection.send((False, TypeError(f"{type(answer[1]).__name__} cannot be sent: {error}")))
        try:
            function, arguments = connection.recv()
        except EOFError:
            return
