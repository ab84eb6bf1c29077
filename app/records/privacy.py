"""Permissions that close the data folder to the other users of the machine."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from app.logs import Logger

log = Logger(__name__)

SECRET_FILES = (
    "gridpose.sqlite3",
    "gridpose.sqlite3-wal",
    "gridpose.sqlite3-shm",
    "key-pepper",
    "first-admin-key",
)
"""What nobody else must read even where the folder is opened to them."""

OF_THE_FILE_SYSTEM = frozenset({"lost+found"})
"""What lies in a folder that is a disk of its own, and is nobody's content."""

_SIGNS = frozenset({"installation.json", "gridpose.sqlite3", "originals", "key-pepper"})
_INCIDENTAL = frozenset({"head.lock", "runner.lock", "migrate.lock", "service.log"})


def exposed(folder: Path) -> list[Path]:
    """Return the folder and those of its secret files that other users may read, write or enter; none on Windows."""
    if os.name != "posix":
        return []
    found = []
    for path in (folder, *(folder / name for name in SECRET_FILES)):
        try:
            mode = path.stat().st_mode
        except (FileNotFoundError, PermissionError):  # not there, or closed to ourselves
            continue
        if mode & 0o077:
            found.append(path)
    return found


def is_foreign(folder: Path, database: Path | None) -> bool:
    """Return whether a folder holds something, and no installation, not even one whose making was interrupted."""
    if not folder.exists():
        return False
    names = {path.name for path in folder.iterdir()} - OF_THE_FILE_SYSTEM
    if names & _SIGNS or (database is not None and database.parent == folder and database.name in names):
        return False
    return any(
        name not in _INCIDENTAL
        and not name.startswith("installation.json.")
        and not (name == "backups" and _holds_only_copies(folder / name))
        for name in names
    )


def _holds_only_copies(folder: Path) -> bool:
    """Return whether a folder holds copies of a former database alone, as a killed migration leaves them."""
    return folder.is_dir() and all(path.name.startswith("gridpose-") for path in folder.iterdir())


def close_to_others(folder: Path) -> None:
    """Take from others what they may do with an existing data folder, where it is ours; else say so in the log."""
    for path in exposed(folder):
        before = stat.S_IMODE(path.stat().st_mode)
        try:
            path.chmod(before & 0o700)
        except PermissionError:
            log.warning("open_to_other_users", path=str(path), mode=f"{before:04o}")
        else:
            log.warning("closed_to_other_users", path=str(path), mode_before=f"{before:04o}")
