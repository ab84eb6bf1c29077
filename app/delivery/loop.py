"""A thread that does what there is to do, again and again, until stopped."""

from __future__ import annotations

import threading
from collections.abc import Callable

from app.errors import ServiceError
from app.logs import Logger

log = Logger(__name__)


class Loop:
    """Calls `step` until it returns False, then waits `every_s`, or until woken."""

    def __init__(self, name: str, step: Callable[[], bool], every_s: float) -> None:
        self._name, self._step, self._every_s = name, step, every_s
        self._stopping = False
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def wake(self) -> None:
        """Say that there is something to do."""
        self._wake.set()

    def begin_stop(self) -> None:
        """Begin no further step."""
        self._stopping = True
        self._wake.set()

    def join(self) -> None:
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
                log.warning("notices_put_off", part=self._name, code=error.code)
            except Exception:
                log.exception("notices_failed", part=self._name)
            if not self._stopping:
                self._wake.wait(self._every_s)
