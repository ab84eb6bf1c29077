"""Originals as files, named by their SHA-256; durable before anyone is told so.

An upload is written to `incoming/`, fsynced, renamed into place, and its folder is fsynced. Only then is the row
written. A crash in between leaves a file without a row: harmless, since the next upload of the same bytes takes its
place, and counted nowhere. Files left in `incoming/` are removed at start.
"""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import structlog

from app.errors import StorageFull, Unavailable

_STRIPES = 64
_BUSY = {errno.EMFILE, errno.ENFILE, errno.ENOMEM}

log = structlog.get_logger(__name__)


class StagedBlob:
    """A file being received: hashed while it is written, not yet under its name."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.size = 0
        self._hash = hashlib.sha256()
        with storage_refusals():
            self._file: BinaryIO = path.open("xb", buffering=0)

    def write(self, chunk: bytes) -> None:
        """Append `chunk`."""
        with storage_refusals():
            rest = memoryview(chunk)
            while rest:
                rest = rest[self._file.write(rest) :]
        self._hash.update(chunk)
        self.size += len(chunk)

    @property
    def sha256(self) -> str:
        """The hash of all bytes so far, 64 lower-case hex digits."""
        return self._hash.hexdigest()

    def flush(self) -> None:
        """Bring the bytes to the disk itself."""
        with storage_refusals():
            os.fsync(self._file.fileno())
        self._file.close()

    def discard(self) -> None:
        """Forget the file; harmless once it has been published."""
        self._file.close()
        self.path.unlink(missing_ok=True)


class LocalBlobs:
    """The originals of one data folder."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._incoming = root / "incoming"
        self._incoming.mkdir(parents=True, exist_ok=True)
        self._guards = tuple(threading.RLock() for _ in range(_STRIPES))

    def path(self, sha256: str) -> Path:
        """Return where the original with this hash lies, or would lie."""
        return self.root / sha256[:2] / sha256

    def stage(self) -> StagedBlob:
        """Begin to receive a file."""
        return StagedBlob(self._incoming / secrets.token_hex(16))

    def holds(self, sha256: str, size: int) -> bool:
        """Tell whether the original is there, as long as it was when it came."""
        try:
            return self.path(sha256).stat().st_size == size
        except FileNotFoundError:
            return False

    def publish(self, staged: StagedBlob) -> None:
        """Put a received file under its name; on return it survives a power cut."""
        target = self.path(staged.sha256)
        staged.flush()
        with storage_refusals():
            if not target.parent.exists():
                target.parent.mkdir(exist_ok=True)
                _sync_folder(self.root)
            # An identical file may be there already; replacing it is as good as keeping it, and surely whole.
            staged.path.replace(target)
            _sync_folder(target.parent)

    @contextmanager
    def guard(self, sha256: str) -> Iterator[None]:
        """Keep `publish` and its row on one side, `remove` on the other: never a row without its file.

        One process at a time serves uploads from a data folder (`head.lock`), so a lock in memory is enough.
        """
        with self._guards[int(sha256[:8], 16) % _STRIPES]:
            yield

    def remove(self, sha256: str) -> None:
        """Delete an original that no row names any more; call it within `guard`."""
        self.path(sha256).unlink(missing_ok=True)

    def prepare(self) -> int:
        """Make every folder, once and durably, and remove what interrupted uploads left; return how many files.

        With the folders there beforehand, an upload has one folder fewer to bring to the disk.
        """
        for number in range(256):
            (self.root / f"{number:02x}").mkdir(exist_ok=True)
        _sync_folder(self.root)
        leftovers = list(self._incoming.iterdir())
        for path in leftovers:
            path.unlink(missing_ok=True)
        return len(leftovers)

    def free_bytes(self) -> int:
        """Return the free space of the disk the originals lie on."""
        return shutil.disk_usage(self.root).free

    def check_room(self, floor_bytes: int, wanted_bytes: int = 0) -> None:
        """Raise StorageFull where storing `wanted_bytes` would leave less than `floor_bytes` free."""
        if self.free_bytes() - wanted_bytes < floor_bytes:
            raise StorageFull("Free disk space is below its floor.")


@contextmanager
def storage_refusals() -> Iterator[None]:
    """Turn a write that failed into a refusal: the client may try again, the log says what the disk said."""
    try:
        yield
    except OSError as error:
        log.error("original_not_written", reason=errno.errorcode.get(error.errno or 0), path=error.filename)
        if error.errno in _BUSY:
            raise Unavailable(
                "The server has too much to do at once.", "Try again shortly.", code="busy"
            ) from error
        raise StorageFull() from error


def _sync_folder(folder: Path) -> None:
    """Make a rename within `folder` durable; Windows does so by itself and cannot open folders."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
