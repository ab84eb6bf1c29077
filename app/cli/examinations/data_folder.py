"""Whether the data folder can hold data safely: there, writable, private, with room, on a disk of ours."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from app.cli.findings import Finding, failed, ok, warn
from app.settings import MIB, Settings

_NETWORK = frozenset({"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "afs", "fuse.sshfs", "ncpfs"})
_SLOW_SYNC_S = 0.1


def examine(settings: Settings) -> Iterator[Finding]:
    folder = settings.data_dir
    if not folder.exists():
        yield _can_be_made(folder)
        return
    if not folder.is_dir():
        yield failed("is no folder", "Give another with --data-dir or GRIDPOSE_DATA_DIR.")
        return
    yield _writable(folder)
    if os.name == "posix":
        yield _private(folder)
    yield _room(folder, settings.disk_floor_bytes)
    yield _local(folder)


def _can_be_made(folder: Path) -> Finding:
    parent = next(p for p in folder.absolute().parents if p.exists())
    if os.access(parent, os.W_OK | os.X_OK):
        return ok("is not there yet; the first start makes it")
    return failed(
        f"is not there, and this user may not make it in {parent}",
        "Make it as an administrator and give it to this user, or name another with --data-dir.",
    )


def _writable(folder: Path) -> Finding:
    """Write, sync and remove a small file, as every upload does."""
    started = time.perf_counter()
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix="doctor-") as file:
            file.write(b"x" * 4096)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return failed(
            f"cannot be written: {error.strerror or error}",
            "Give it to the user the service runs as (chown), or free space.",
        )
    seconds = time.perf_counter() - started
    if seconds > _SLOW_SYNC_S:
        return warn(
            f"can be written, but a write takes {1000 * seconds:.0f} ms to reach the disk",
            "Every upload waits for that; a local SSD takes a few ms.",
        )
    return ok(f"can be written; a write reaches the disk in {1000 * seconds:.1f} ms")


def _private(folder: Path) -> Finding:
    pepper = folder / "key-pepper"
    exposed = [path for path in (folder, pepper) if path.exists() and path.stat().st_mode & 0o077]
    if pepper in exposed:
        return warn("key-pepper can be read by other users of this machine", f"chmod 600 {pepper}")
    if exposed:
        return warn("can be read by other users of this machine", f"chmod 700 {folder}")
    return ok("is closed to other users")


def _room(folder: Path, floor: int) -> Finding:
    free = shutil.disk_usage(folder).free
    if free < floor:
        return failed(
            f"{_size(free)} free, below the floor of {_size(floor)}: uploads are refused",
            "Free space on that disk, or lower GRIDPOSE_DISK_FLOOR_BYTES.",
        )
    if free < 4 * floor:
        return warn(
            f"{_size(free)} free; uploads are refused below {_size(floor)}",
            "Free space on that disk before it is full.",
        )
    return ok(f"{_size(free)} free")


def _local(folder: Path) -> Finding:
    """Tell a network file system, on which SQLite's shared memory does not work, by the mount table."""
    mounts = Path("/proc/self/mounts")
    if not mounts.exists():
        return ok("kind of file system not examined on this system")
    best = ("", "")
    for line in mounts.read_text(encoding="utf-8", errors="replace").splitlines():
        _, point, kind, *_ = line.split(" ")
        if folder.absolute().is_relative_to(point) and len(point) >= len(best[0]):
            best = (point, kind)
    if best[1] in _NETWORK:
        return failed(
            f"lies on a network file system ({best[1]}), on which SQLite loses data",
            "Use a folder on a disk of this machine, or PostgreSQL (GRIDPOSE_DATABASE_URL).",
        )
    return ok(f"lies on a file system of this machine ({best[1] or 'unknown'})")


def _size(count: int) -> str:
    return f"{count / (1024 * MIB):.1f} GiB" if count >= 1024 * MIB else f"{count / MIB:.0f} MiB"
