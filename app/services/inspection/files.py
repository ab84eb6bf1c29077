"""Checks of the files in the data folder: their disk is writable, this user may use them, their owner is right."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from app.services.inspection.check_result import CheckResult, failed, ok, warn

_READ = ("installation.json", "key-pepper", "first-admin-key", "last-backup.json")
_CHANGED = (
    *("gridpose.sqlite3", "gridpose.sqlite3-wal", "gridpose.sqlite3-shm"),
    *("head.lock", "runner.lock", "migrate.lock"),
)
_FOLDERS = (
    *("originals", "originals/incoming", "thumbnails", "backups"),
    *(f"originals/{number:02x}" for number in range(256)),
)
_MAX_LISTED = 5


def check(folder: Path) -> Iterator[CheckResult]:
    """Check owner and permissions of the service's own files and folders, of those that are there."""
    refused, foreign = [], []
    for path, needed in _entries(folder):
        if not os.path.lexists(path):
            continue
        if not os.access(path, needed):
            refused.append(path)
        elif _is_foreign(path, folder):
            foreign.append(path)
    owner = _owner(folder)
    for path in refused[:_MAX_LISTED]:
        yield failed(
            f"{path} cannot be used by this user; it belongs to {_owner(path)}",
            f"Give it to the user that the service runs as: chown -R {owner} {path}",
        )
    for path in foreign[:_MAX_LISTED]:
        yield warn(
            f"{path} belongs to {_owner(path)}, and the data folder to {owner}",
            f"The service may not be able to use it: chown -R {owner} {path}",
        )
    if not refused and not foreign:
        yield ok("holds no file that is closed to this user")


def is_read_only(folder: Path) -> bool:
    """Return whether the folder's file system is mounted read-only, whoever asks and whoever owns the files."""
    if sys.platform == "win32":
        return False
    return bool(os.statvfs(folder).f_flag & os.ST_RDONLY)


def read_only(folder: Path) -> CheckResult:
    """Say that nothing can be stored, and that what is there is to be brought to another disk."""
    return failed(
        "is on a file system that is mounted read-only: nothing can be stored",
        "The system does that to a disk that fails: `dmesg` has the reason. Stop the service, copy the folder off now "
        f'(`cp -a {folder} /OTHER/DISK`), and see docs/operations.md, "A read-only disk".',
    )


def _entries(folder: Path) -> Iterator[tuple[Path, int]]:
    for name in _READ:
        yield folder / name, os.R_OK
    for name in _CHANGED:
        yield folder / name, os.R_OK | os.W_OK
    for name in _FOLDERS:
        yield folder / name, os.R_OK | os.W_OK | os.X_OK


def _is_foreign(path: Path, folder: Path) -> bool:
    """Return whether root, who may use everything, looks at a file that the folder's owner may not have."""
    if sys.platform == "win32" or os.geteuid() != 0:
        return False
    owner = folder.stat().st_uid
    return owner not in (0, path.lstat().st_uid)


def _owner(path: Path) -> str:
    """Return the name of a file's owner, or his number where he has none."""
    if sys.platform == "win32":
        return "USER"
    import pwd

    number = path.lstat().st_uid
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)
