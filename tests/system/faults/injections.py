"""Faults, each as a context that ends it, or as a function that brings it about once. Linux only, as the module is."""

from __future__ import annotations

import contextlib
import itertools
import os
import resource
import shutil
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import httpx2

_PIECE = 1024 * 1024
_LOOKS = 20
_LOOK_EVERY_S = 0.025


def missing_tool(name: str) -> str | None:
    """Return why a fault cannot be brought about here, None where it can."""
    if name == "cc":
        return None if shutil.which("cc") else "there is no C compiler (cc) to build what is preloaded with"
    if name == "mount":
        return None if os.geteuid() == 0 and _may_mount() else "only root may mount a small disk"
    raise ValueError(name)


def _may_mount() -> bool:
    """Whether this root has the right to mount, which a container's root has not."""
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    effective = int(status.split("CapEff:")[1].split()[0], 16)
    return bool(effective >> 21 & 1)  # CAP_SYS_ADMIN


@contextlib.contextmanager
def small_disk(folder: Path, size_mb: int) -> Iterator[Path]:
    """A disk of a few MB, mounted for as long as this context lasts."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size_mb}m", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


@contextlib.contextmanager
def filled(folder: Path) -> Iterator[None]:
    """Fill the disk that `folder` lies on to its last byte."""
    filler = folder / "filler"
    with filler.open("wb", buffering=0) as file:
        for piece in (_PIECE, 4096, 1):
            with contextlib.suppress(OSError):
                while file.write(b"x" * piece) == piece:
                    pass
    try:
        yield
    finally:
        filler.unlink()


@contextlib.contextmanager
def limited(pid: int, limit: int, value: int) -> Iterator[None]:
    """Lower one of a running process's soft resource limits."""
    soft, hard = resource.prlimit(pid, limit)
    resource.prlimit(pid, limit, (value, hard))
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            resource.prlimit(pid, limit, (soft, hard))


def open_files(pid: int) -> int:
    """Return the limit under which a process opens no more files: the lowest number it does not hold for good.

    The kernel gives a new file the lowest free number. A limit above the highest number in use would leave free
    those below it, which a file that is open for a moment may have passed over.
    """
    held = _open_now(pid)
    for _ in range(_LOOKS):
        time.sleep(_LOOK_EVERY_S)
        held &= _open_now(pid)
    return next(number for number in itertools.count() if number not in held)


def _open_now(pid: int) -> set[int]:
    return {int(entry.name) for entry in Path(f"/proc/{pid}/fd").iterdir()}


def address_space(pid: int) -> int:
    """Return how many bytes of addresses a process has in use."""
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="utf-8").split()[0]) * resource.getpagesize()


@contextlib.contextmanager
def stopped(pid: int) -> Iterator[None]:
    """Halt a process, as a debugger or a virtual machine's pause does."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def cut_upload(url: str, path: str, key: str, data: bytes, *, reset: bool) -> None:
    """Send half of an upload, then nothing more: a cut cable (reset), or a client that closed."""
    at = urlsplit(url)
    assert at.hostname is not None
    with socket.create_connection((at.hostname, at.port), timeout=10) as connection:
        head = (
            f"PUT {path} HTTP/1.1\r\nHost: {at.netloc}\r\nAuthorization: Bearer {key}\r\n"
            f"Content-Type: application/octet-stream\r\nContent-Length: {len(data)}\r\n\r\n"
        )
        connection.sendall(head.encode() + data[: len(data) // 2])
        if reset:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


class Clock:
    """The wall clock of a service started with `environment`, which `step` moves while it runs."""

    def __init__(self, folder: Path) -> None:
        self._file, self._library = folder / "clock", build_library("stepped_clock", folder)
        self.step(0)

    @property
    def environment(self) -> dict[str, str]:
        return {"LD_PRELOAD": str(self._library), "STEPPED_CLOCK": str(self._file)}

    def step(self, seconds: int) -> None:
        """Set the clock `seconds` off the true time."""
        changed = self._file.with_suffix(".new")
        changed.write_text(f"{seconds:+d}\n", encoding="utf-8")
        changed.replace(self._file)


def killed_at_fsync(library: Path, number: int) -> list[str]:
    """The command that ends a program by SIGKILL when it is about to make its `number`-th fsync."""
    return ["env", f"LD_PRELOAD={library}", f"KILL_AT_FSYNC={number}"]


def build_library(name: str, folder: Path) -> Path:
    """Compile one of the C sources here into a library for LD_PRELOAD."""
    library = folder / f"{name}.so"
    source = Path(__file__).with_name(f"{name}.c")
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    return library


@contextlib.contextmanager
def undeletable(files: list[Path]) -> Iterator[None]:
    """Keep files from being deleted: by their attribute where one is root, by their folders' modes elsewhere."""
    if os.geteuid() == 0:
        _set_immutable(files, on=True)
        try:
            yield
        finally:
            _set_immutable([file for file in files if file.exists()], on=False)
        return
    folders = {file.parent for file in files}
    for folder in folders:
        folder.chmod(0o500)
    try:
        yield
    finally:
        for folder in folders:
            folder.chmod(0o700)


def _set_immutable(files: list[Path], *, on: bool) -> None:
    subprocess.run(["chattr", "+i" if on else "-i", *map(str, files)], check=True, capture_output=True)


def answers(url: str, within_s: float) -> bool:
    """Whether the service answers at all within so many seconds."""
    try:
        httpx2.get(f"{url}/livez", timeout=within_s)
    except httpx2.TransportError:
        return False
    return True
