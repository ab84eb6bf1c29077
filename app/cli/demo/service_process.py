"""A service in a process of its own, for the demo, the benchmarks and the system tests."""

from __future__ import annotations

import os
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import httpx2

_SERVICE = re.compile(r"service\s+(http://\S+)")
_ADMIN_KEY = re.compile(r"admin key\s+is in (.+)")
STOP_WITHIN_S = 25.0
_READY_EVERY_S = 0.15
"""A question costs the service and this process 10 ms of processor time, which its workers need to start."""


class ServiceStartError(Exception):
    """The service did not start; the message ends with what it said."""


class _TooLate(Exception):
    """The time in which the service should be ready is over; the message says what it lacks."""


class ServiceProcess:
    """`gridpose serve` on a free port of the loopback address, over a data folder.

    `url` is where it listens; `admin_key` is the folder's first, as long as the file it lies in is there. What
    the service logs goes to `service.log` in the folder. `wrapper` is a command to start it by, which must become the
    service itself (as `env` does), so that signals and limits reach the right process.
    """

    def __init__(
        self,
        data_dir: Path,
        environment: Mapping[str, str] | None = None,
        *,
        port: int = 0,
        wrapper: Sequence[str] = (),
    ) -> None:
        self.data_dir = data_dir
        self.url = ""
        self.admin_key: str | None = None
        self._environment = {**os.environ, "PYTHONUNBUFFERED": "1", **(environment or {})}
        self._port = port
        self._wrapper = tuple(wrapper)
        self._process: subprocess.Popen[str] | None = None

    @property
    def process(self) -> subprocess.Popen[str]:
        """The running `gridpose serve`."""
        assert self._process is not None, "the service was not started"
        return self._process

    def start(self, *, ready_within_s: float = 300.0, until_ready: bool = True) -> Self:
        """Start the service and return when `/readyz` says so, or as soon as it listens.

        The first start on a processor that nothing was compiled for takes minutes until it is ready.
        """
        self.data_dir.mkdir(parents=True, exist_ok=True)
        self.url = ""
        deadline = time.monotonic() + ready_within_s
        command = [sys.executable, "-m", "app.cli", "serve", "--host", "127.0.0.1", "--port", str(self._port)]
        with (self.data_dir / "service.log").open("a", encoding="utf-8") as log:
            self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
                [*self._wrapper, *command, "--data-dir", str(self.data_dir)],
                stdout=subprocess.PIPE,
                stderr=log,
                stdin=subprocess.DEVNULL,
                text=True,
                env=self._environment,
            )
        try:
            self._read_announcement(deadline)
            if until_ready:
                self._await_ready(deadline)
        except _TooLate as late:
            self.kill()
            raise ServiceStartError(
                f"The service was not ready within {ready_within_s:.0f} s. {late}\n"
                "This machine is slow or busy with something else; a first start also compiles, and what it compiled "
                "is kept. End what else computes, and do the same again. What the service said is in "
                f"{self.data_dir / 'service.log'}."
            ) from None
        except BaseException:
            self.kill()
            raise
        return self

    def stop(self) -> int:
        """End the service as an operator would (SIGTERM) and return its exit code."""
        if self._process is None:
            return 0
        self._process.terminate()
        try:
            return self._process.wait(STOP_WITHIN_S)
        except subprocess.TimeoutExpired:
            self.kill()
            raise

    def kill(self) -> None:
        """End the service without notice (SIGKILL)."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _read_announcement(self, deadline: float) -> None:
        lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        output = self.process.stdout
        assert output is not None

        def follow() -> None:  # to the end, lest the service blocks on a full pipe
            with output:
                for line in output:
                    lines.put(line)
            lines.put(None)

        threading.Thread(target=follow, daemon=True).start()
        while not self.url:
            try:
                line = lines.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                raise _TooLate("It did not say where it listens.") from None
            if line is None:
                raise self._failure(f"ended with code {self.process.wait()}")
            if match := _ADMIN_KEY.search(line):
                self.admin_key = Path(match[1]).read_text(encoding="ascii").strip()
            if match := _SERVICE.search(line):
                self.url = match[1]

    def _await_ready(self, deadline: float) -> None:
        lacking = "It answers nothing."
        # With a key, what is not ready is named.
        headers = {"Authorization": f"Bearer {self.admin_key}"} if self.admin_key else {}
        # One client throughout: each new one reads all certificates, some 30 ms of processor time.
        with httpx2.Client(headers=headers, timeout=5.0) as client:
            while time.monotonic() < deadline:
                if self.process.poll() is not None:
                    raise self._failure(f"ended with code {self.process.returncode}")
                try:
                    response = client.get(f"{self.url}/readyz")
                except httpx2.TransportError as error:
                    lacking = f"{error}."
                else:
                    if response.status_code == 200:
                        return
                    lacking = _lacking(response)
                time.sleep(_READY_EVERY_S)
        raise _TooLate(lacking)

    def _failure(self, what: str) -> ServiceStartError:
        log = (self.data_dir / "service.log").read_text(encoding="utf-8", errors="replace")
        return ServiceStartError(f"the service {what}\n" + "\n".join(log.splitlines()[-15:]))


def _lacking(response: httpx2.Response) -> str:
    """Return what is not ready, in the service's words."""
    try:
        return str(response.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return f"It answers {response.status_code}."
