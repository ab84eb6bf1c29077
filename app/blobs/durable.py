"""Small files that appear whole and survive a power cut."""

from __future__ import annotations

import ctypes
import errno
import os
import secrets
import sys
from collections.abc import Callable
from pathlib import Path

from app.logs import Logger

_WORTH_BEGINNING = 256 * 1024
_SYNC_FILE_RANGE_WRITE = 2


def _sync_file_range() -> Callable[[int, int, int, int], int] | None:
    if sys.platform != "linux":
        return None
    function = getattr(ctypes.CDLL(None), "sync_file_range", None)  # not every C library has it
    if function is not None:
        function.argtypes = (ctypes.c_int, ctypes.c_int64, ctypes.c_int64, ctypes.c_uint)
    return function


_SYNC_FILE_RANGE = _sync_file_range()
log = Logger(__name__)


def write_durably(path: Path, content: bytes) -> None:
    """Write a file whole, in place of any that is there, and bring it and its name to the disk."""
    temporary = _write_alongside(path, content)
    try:
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def write_once(path: Path, content: bytes) -> None:
    """Write a file as `write_durably` does, but never in place of one that another process just made."""
    temporary = _write_alongside(path, content)
    try:
        if hasattr(os, "link"):
            os.link(temporary, path)
        else:
            temporary.rename(path)
    except FileExistsError:
        pass
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def sync_folder(folder: Path | str) -> None:
    """Make a rename within `folder` durable; Windows does so by itself and cannot open folders."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def begin_writing(descriptor: int, offset: int, length: int) -> None:
    """Let the system begin to write a piece of a file to the disk, that a later fsync finds less to do.

    It promises nothing and waits for nothing; only Linux has it, and small pieces are not worth it.
    """
    if _SYNC_FILE_RANGE is not None and length >= _WORTH_BEGINNING:
        _SYNC_FILE_RANGE(descriptor, offset, length, _SYNC_FILE_RANGE_WRITE)


def remove_file(path: Path) -> bool:
    """Remove a file, whether it is there or not; return False, and log why, where the system refuses."""
    try:
        path.unlink(missing_ok=True)
    except NotADirectoryError:
        return True
    except OSError as error:
        log.warning("file_not_removed", path=str(path), reason=errno.errorcode.get(error.errno or 0))
        return False
    return True


def _write_alongside(path: Path, content: bytes) -> Path:
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    return temporary
