"""A thread of a running service that does one step after another."""

from __future__ import annotations

import threading
from collections.abc import Callable

from app.errors import ServiceError
from app.logs import Logger, Sparingly

log = Logger(__name__)


class Loop:
    """A thread that calls `step` again while it returns True, else after `every_s` or when woken, until stopped.

    What a step raises is logged, what it is put off for once a minute, and the loop goes on.
    """

    def __init__(self, name: str, step: Callable[[], bool | None], every_s: float) -> None:
        self._name, self._step, self._every_s = name, step, every_s
        self._stopping = False
        self._may_log = Sparingly()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin; the first step at once, in the thread."""
        self._thread.start()

    def is_stopping(self) -> bool:
        """Return whether no further step begins: one that takes long asks this."""
        return self._stopping

    def wake(self) -> None:
        """Say that there is something to do."""
        self._wake.set()

    def pause(self, seconds: float) -> None:
        """Wait so long, or until woken or stopped."""
        self._wake.wait(seconds)

    def begin_stop(self) -> None:
        """Begin no further step."""
        self._stopping = True
        self._wake.set()

    def stop(self) -> None:
        """End; returns when no step is being done."""
        self.begin_stop()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._stopping:
            self._wake.clear()
            try:
                if self._step():
                    continue
            except ServiceError as error:  # a full disk or a busy database passes
                if self._may_log.due(error.code):
                    log.warning("step_put_off", part=self._name, code=error.code)
            except Exception:
                log.exception("step_failed", part=self._name)
            if not self._stopping:
                self._wake.wait(self._every_s)
