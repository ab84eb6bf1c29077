"""What is reported to systemd, over a real socket."""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.cli.server.supervision import Supervisor
from tests.support.environment.systemd import listening, message

if sys.platform != "linux":
    pytest.skip("systemd is Linux's", allow_module_level=True)


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    """The socket that messages arrive at."""
    with listening(tmp_path / "notify") as listener:
        yield listener


def test_ready_is_said_once_and_life_in_every_half_of_the_interval(systemd: socket.socket) -> None:
    environment = {"NOTIFY_SOCKET": systemd.getsockname(), "WATCHDOG_USEC": "100000"}
    supervisor = Supervisor.from_environment({**environment, "WATCHDOG_PID": str(os.getpid())})
    for _ in range(3):
        supervisor.beat(ready=False)
    assert message(systemd)[0] == "EXTEND_TIMEOUT_USEC=30000000"
    first = (
        time.monotonic()
    )  # before it is said: the next one is due an interval after that, however busy the machine
    supervisor.beat(ready=True)
    assert message(systemd)[0] == "READY=1"
    assert message(systemd) == ["WATCHDOG=1"]
    systemd.setblocking(False)
    while True:
        supervisor.beat(ready=True)
        try:
            assert message(systemd) == ["WATCHDOG=1"]
            break
        except BlockingIOError:
            assert time.monotonic() - first < 60.0
    assert time.monotonic() - first > 0.03
    supervisor.stopping()
    assert message(systemd) == ["STOPPING=1"]


@pytest.mark.parametrize("variables", [{"WATCHDOG_PID": "1", "WATCHDOG_USEC": "1"}, {}])
def test_a_watchdog_meant_for_another_process_hears_nothing(
    systemd: socket.socket, variables: dict[str, str]
) -> None:
    supervisor = Supervisor.from_environment({"NOTIFY_SOCKET": systemd.getsockname(), **variables})
    for _ in range(2):
        supervisor.beat(ready=True)
    supervisor.stopping()
    assert message(systemd)[0] == "READY=1"
    assert message(systemd) == ["STOPPING=1"]


def test_an_abstract_address_is_understood_and_an_absent_one_does_no_harm(tmp_path: Path) -> None:
    name = f"gridpose-{tmp_path.name}-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind("\0" + name)
        Supervisor.from_environment({"NOTIFY_SOCKET": "@" + name}).stopping()
        assert message(listener) == ["STOPPING=1"]
    for environment in ({}, {"NOTIFY_SOCKET": str(tmp_path / "nobody")}):
        Supervisor.from_environment(environment).stopping()
