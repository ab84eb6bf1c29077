"""State of this process for systemd: ready, alive, stopping. Nothing is sent without `NOTIFY_SOCKET`.

`Type=notify` waits for READY=1, `WatchdogSec=` expects WATCHDOG=1 in every interval; see sd_notify(3).
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Mapping
from typing import Self

from app.logs import Logger

log = Logger(__name__)

_MORE_TIME = "EXTEND_TIMEOUT_USEC=30000000"
_MORE_TIME_EVERY_S = 10.0
_MAX_GIVE_UP_SHUTDOWN_S = 15.0
"""Time for the shutdown after the runner gave up; with the runner's `MAX_UNABLE_S` it stays below 60 s."""


class Supervisor:
    """Sends the state of a process to its supervisor. Call `beat` several times a second."""

    def __init__(self, address: str | None, watchdog_s: float | None) -> None:
        self._address = address
        self._watchdog_every_s = None if watchdog_s is None else watchdog_s / 2.0
        self._announced = False
        self._next_s = 0.0

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Self:
        """Return the supervisor that started this process; without one, an object that sends nothing."""
        microseconds = environment.get("WATCHDOG_USEC", "")
        meant = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        watchdog_s = int(microseconds) / 1e6 if microseconds.isdecimal() and meant else None
        return cls(environment.get("NOTIFY_SOCKET") or None, watchdog_s or None)

    def beat(self, *, ready: bool) -> None:
        """Report that the process is ready, once, and then that it is alive. Call it for a healthy process only.

        Until it is ready, more time is requested: the first start on a new processor compiles kernels.
        """
        now_s = time.monotonic()
        if not self._announced and ready:
            self._announced, self._next_s = True, 0.0
            self._send("READY=1\nSTATUS=Ready")
        if now_s < self._next_s:
            return
        if not self._announced:
            self._next_s = now_s + _MORE_TIME_EVERY_S
            self._send(f"{_MORE_TIME}\nSTATUS=Starting the worker processes")
        elif self._watchdog_every_s is not None:
            self._next_s = now_s + self._watchdog_every_s
            self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the process is about to exit."""
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        if self._address is None:
            return
        # @ stands for the NUL at the beginning of an abstract socket name of Linux.
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.settimeout(1.0)
                sender.sendto(message.encode(), address)
        except OSError as error:  # the service continues without its supervisor
            log.warning("supervisor_not_reached", error=repr(error))


def end_after_giving_up() -> None:
    """Log the reason, and exit by force where the shutdown takes too long: acknowledged uploads are on disk."""
    log.critical(
        "nothing_can_be_computed",
        advice="The process exits to be restarted. See the messages before this one; check memory and limits.",
    )
    last_resort = threading.Timer(_MAX_GIVE_UP_SHUTDOWN_S, os._exit, [1])
    last_resort.daemon = True
    last_resort.start()
