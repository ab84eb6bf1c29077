"""Checks of the data folder: it exists, is writable, private, has free space, and is on a local disk."""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError

from app.errors import InstallationRefused, ServiceError, StorageFull, refusal_of
from app.records.database import Database
from app.records.privacy import exposed
from app.records.tables import ApiKey, Installation
from app.services.first_key import FIRST_KEY_FILE, id_in
from app.services.inspection import files
from app.services.inspection.check_result import CheckResult, failed, ok, unusable, warn
from app.services.installation.binding import require_installation, require_pepper, require_same, sqlite_path
from app.services.installation.identity import read_identity
from app.settings import Settings, is_loopback

_NETWORK_FILE_SYSTEMS = frozenset(
    {"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "afs", "fuse.sshfs", "ncpfs"}
)
_MAX_SYNC_S = 0.1
_FULL = (
    "Remove other files from that disk, or enlarge it; then delete sessions through the service, never files of this "
    'folder by hand (docs/operations.md, "A full disk").'
)


def check(settings: Settings) -> Iterator[CheckResult]:
    """Check the data folder, and whether it belongs to its database."""
    folder = settings.data_dir
    if not folder.exists():
        yield _can_be_made(folder)
        yield _without_installation()
        return
    if not folder.is_dir():
        yield failed("is not a folder", "Choose another with --data-dir or GRIDPOSE_DATA_DIR.")
        return
    if files.is_read_only(folder):
        # Every check of permissions would find the same, and advise what cannot be done there.
        yield files.read_only(folder)
        return
    yield _writable(folder)
    yield from files.check(folder)
    if os.name == "posix":
        yield from _private(folder)
    yield from _first_key(settings)
    yield _room(folder, settings.disk_floor_bytes)
    yield _local(folder)
    yield _transport(settings.host)
    try:
        yield _bound(settings)
    except OSError as error:
        yield unusable(error, folder)


def _bound(settings: Settings) -> CheckResult:
    """Check that folder, database and pepper belong together, as far as they can be read."""
    try:
        require_installation(settings)
    except InstallationRefused as error:
        return failed(error.detail, error.advice)
    identity = read_identity(settings.data_dir)
    if identity is None:
        return warn("has no installation id yet", "The next start creates one; nothing to do.")
    file = sqlite_path(settings)
    if file is not None and not file.exists():
        return failed(
            f"belongs to installation {identity.id}, whose database does not exist", "Restore a backup."
        )
    database = Database(settings.effective_database_url)
    try:
        with database.read() as records:
            row = records.get(Installation, 1)
            if row is None:
                return warn(
                    "the database has no installation id", "The next start adds it, or reports why not."
                )
            require_same(settings, identity, row)
            require_pepper(settings, records, row)
    except InstallationRefused as error:
        return failed(error.detail, error.advice)
    except (ServiceError, DBAPIError):
        return warn("cannot be compared with its database", "See the checks of the database.")
    finally:
        database.dispose()
    return ok(f"and database belong to installation {identity.id}")


def _without_installation() -> CheckResult:
    return failed(
        "holds no installation", "Check --data-dir and GRIDPOSE_DATA_DIR; `gridpose serve` creates one."
    )


def _can_be_made(folder: Path) -> CheckResult:
    parent = next(p for p in folder.absolute().parents if p.exists())
    if os.access(parent, os.W_OK | os.X_OK):
        return ok("does not exist yet; the first start creates it")
    return failed(
        f"does not exist, and this user may not create it in {parent}",
        "Create it as an administrator and give it to this user, or choose another with --data-dir.",
    )


def _writable(folder: Path) -> CheckResult:
    """Write, sync and remove a small file, as every upload does."""
    started = time.perf_counter()
    try:
        with tempfile.NamedTemporaryFile(dir=folder, prefix="doctor-") as file:
            file.write(b"x" * 4096)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        is_full = isinstance(refusal_of(error), StorageFull)
        return failed(
            f"cannot be written: {error.strerror or error}",
            _FULL if is_full else "Give it to the user the service runs as (chown).",
        )
    seconds = time.perf_counter() - started
    if seconds > _MAX_SYNC_S:
        return warn(
            f"can be written, but a write takes {1000 * seconds:.0f} ms to reach the disk",
            "Every upload waits for this; a local SSD takes a few ms.",
        )
    return ok(f"can be written; a write reaches the disk in {1000 * seconds:.1f} ms")


def _private(folder: Path) -> Iterator[CheckResult]:
    found = exposed(folder)
    for path in found:
        what = "can" if path == folder else f"{path.name} can"
        yield warn(
            f"{what} be read by other users of this machine", f"chmod {700 if path == folder else 600} {path}"
        )
    if not found:
        yield ok("is private to this user")


def _first_key(settings: Settings) -> Iterator[CheckResult]:
    """Ask to store the first admin key elsewhere, unless it is valid no more."""
    path = settings.data_dir / FIRST_KEY_FILE
    if not os.access(path, os.F_OK):
        return
    if _is_worthless(settings, path):
        yield warn(f"{FIRST_KEY_FILE} holds a key that is not valid any more", f"Remove {path}")
        return
    yield warn(
        f"{FIRST_KEY_FILE} still holds the first admin key",
        f"Store the key elsewhere, then remove {path}",
    )


def _is_worthless(settings: Settings, path: Path) -> bool:
    """Return whether the database says that the key in a file is revoked; False where that cannot be known."""
    file = sqlite_path(settings)
    try:
        key_id = id_in(path)
        if key_id is None or (file is not None and not file.exists()):
            return False
        database = Database(settings.effective_database_url)
        try:
            with database.read() as records:
                revoked = sa.select(ApiKey.id).where(ApiKey.id == key_id, ApiKey.revoked_at.is_not(None))
                return records.scalar(revoked) is not None
        finally:
            database.dispose()
    except (OSError, ServiceError, DBAPIError):
        return False


def _transport(host: str) -> CheckResult:
    if is_loopback(host):
        return ok(f"is served on {host} only")
    return warn(
        f"is served on {host} by plain HTTP: others on the network can read keys and images",
        "Put a reverse proxy with TLS in front of it and bind the service to 127.0.0.1.",
    )


def _room(folder: Path, floor: int) -> CheckResult:
    disk = shutil.disk_usage(folder)
    free = disk.free
    if floor > disk.total:
        return failed(
            f"{_size(free)} free of {_size(disk.total)}, and the minimum is {_size(floor)}: uploads are refused",
            "Lower GRIDPOSE_DISK_FLOOR_BYTES: no room on this disk is enough.",
        )
    if free < floor:
        return failed(
            f"{_size(free)} free, below the minimum of {_size(floor)}: uploads are refused",
            _FULL,
        )
    if free < 4 * floor:
        return warn(
            f"{_size(free)} free; uploads are refused below {_size(floor)}",
            "Delete sessions through the service, or other files from that disk, before it is full.",
        )
    return ok(f"{_size(free)} free")


def _local(folder: Path) -> CheckResult:
    """Identify a network file system, on which SQLite's shared memory does not work, by the mount table."""
    mounts = Path("/proc/self/mounts")
    if not mounts.exists():
        return ok("kind of file system not checked on this operating system")
    best = ("", "")
    for line in mounts.read_text(encoding="utf-8", errors="replace").splitlines():
        _, point, kind, *_ = line.split(" ")
        if folder.absolute().is_relative_to(point) and len(point) >= len(best[0]):
            best = (point, kind)
    if best[1] in _NETWORK_FILE_SYSTEMS:
        return failed(
            f"is on a network file system ({best[1]}), on which SQLite loses data",
            "Use a folder on a disk of this machine, or PostgreSQL (GRIDPOSE_DATABASE_URL).",
        )
    return ok(f"is on a file system of this machine ({best[1] or 'unknown'})")


def _size(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
