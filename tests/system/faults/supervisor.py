"""A service that is started again whenever it ends, as systemd and container engines do."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import httpx2

from app.cli.demo.service_process import ServiceProcess, ServiceStartError

_ATTEMPTS = 60
_PAUSE_S = 0.25
_READY_WITHIN_S = 90.0


class Supervisor:
    """Keeps `gridpose serve` running over one data folder.

    `wrapper` gives the command that start number 0, 1, ... is made by. `url` is empty while there is no service.
    """

    def __init__(
        self,
        data_dir: Path,
        environment: Mapping[str, str] | None = None,
        wrapper: Callable[[int], Sequence[str]] = lambda start: (),
    ) -> None:
        self.data_dir = data_dir
        self.url = ""
        self.admin_key: str | None = None
        self.exits: list[int | None] = []
        self._environment = {"GRIDPOSE_WORKERS": "1", **(environment or {})}
        self._wrapper = wrapper
        self._starts = 0
        self._service: ServiceProcess | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._keep_running, daemon=True)

    @property
    def pid(self) -> int:
        """The process id of the running service."""
        assert self._service is not None
        return self._service.process.pid

    @property
    def starts(self) -> int:
        return self._starts

    def __enter__(self) -> Self:
        self._thread.start()
        self.until_ready()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._service is not None:
            self._service.kill()
        self._thread.join(30)

    def until_ready(self) -> None:
        """Wait until `/readyz` says so, in whatever life of the service; each life has its own time to get there."""
        lives = self._starts
        deadline = time.monotonic() + _READY_WITHIN_S
        answer = "nothing"
        while time.monotonic() < deadline:
            if lives != self._starts:
                lives = self._starts
                deadline = time.monotonic() + _READY_WITHIN_S
            if url := self.url:
                try:
                    response = httpx2.get(f"{url}/readyz", timeout=10.0)
                except httpx2.TransportError as error:
                    answer = repr(error)
                else:
                    if response.status_code == 200:
                        return
                    answer = response.text
            self._ended.wait(0.05)
        raise AssertionError(f"the service did not become ready again; exits {self.exits}; last: {answer}")

    def restart(self) -> None:
        """Have the service end as an operator would, and wait until it is ready again."""
        starts = self._starts
        assert self._service is not None
        self._service.process.terminate()
        deadline = time.monotonic() + _READY_WITHIN_S
        while self._starts == starts:
            assert time.monotonic() < deadline, "the service did not end on SIGTERM"
            self._ended.wait(0.05)
        self.until_ready()

    def kill(self) -> None:
        """End the service without notice; the next life begins at once."""
        assert self._service is not None
        self._service.process.kill()

    def _keep_running(self) -> None:
        refused = 0
        while not self._ended.is_set() and refused < _ATTEMPTS:
            service = ServiceProcess(self.data_dir, self._environment, wrapper=self._wrapper(self._starts))
            self._starts += 1
            try:
                service.start(until_ready=False)
            except ServiceStartError:
                refused += 1
                self.exits.append(None)
                self._ended.wait(_PAUSE_S)
                continue
            refused = 0
            self._service = service
            self.admin_key = service.admin_key or self.admin_key
            self.url = service.url
            if self._ended.is_set():  # asked to end while this one started
                service.kill()
            code = service.process.wait()
            self.url = ""
            self.exits.append(code)
