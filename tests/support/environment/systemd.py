"""The socket that a supervised process reports to, as systemd holds it."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def listening(path: Path) -> Iterator[socket.socket]:
    """A socket at `path` that messages arrive at, each as one datagram."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(path))
        listener.settimeout(120.0)
        yield listener


def message(listener: socket.socket) -> list[str]:
    """Wait for the next message and return its lines."""
    return listener.recv(4096).decode().splitlines()
