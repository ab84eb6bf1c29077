"""Reading originals by their hash: bytes that are not the ones uploaded are never measured, drawn or delivered."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

from app.blobs.objects import is_object_address, read_object
from app.errors import OriginalCorrupt, OriginalMissing, refusal_of
from app.logs import Logger

PIECE = 1024 * 1024
"""Bytes read at a time, so that no original is in memory whole for being checked."""

log = Logger(__name__)


def read_original(address: str | Path, sha256: str) -> bytes:
    """Return the bytes of the original at `address`, a path or one of S3, whose hash is `sha256`.

    Raises OriginalMissing, OriginalCorrupt where the bytes have another hash or the disk cannot read them, and
    Unavailable where S3 cannot be reached or the service's user may not read the file.
    """
    with _reading():
        where = str(address)
        data = read_object(where) if is_object_address(where) else Path(where).read_bytes()
    if hashlib.sha256(data).hexdigest() != sha256:
        raise OriginalCorrupt
    return data


def open_original(path: Path, sha256: str, size: int) -> FileIO:
    """Return the original at `path`, opened and at its beginning, once all of its bytes were found to be right.

    A file that is removed or replaced afterwards stays readable through what is returned; on Windows it cannot be
    removed. Raises as `read_original` does; a wrong length is noticed without reading.
    """
    with _reading():
        file = path.open("rb", buffering=0)
    try:
        with _reading():
            whole = os.fstat(file.fileno()).st_size == size and hash_of(file) == sha256
            file.seek(0)
        if not whole:
            raise OriginalCorrupt
    except BaseException:
        file.close()
        raise
    return file


def is_whole(path: Path, sha256: str, size: int) -> bool:
    """Return whether the original at `path` is there and can be read with all of its bytes as uploaded."""
    try:
        open_original(path, sha256, size).close()
    except (OriginalMissing, OriginalCorrupt):
        return False
    return True


def hash_of(file: FileIO) -> str:
    """Return the SHA-256 of the rest of `file`, 64 lower-case hex digits."""
    digest = hashlib.sha256()
    buffer = memoryview(bytearray(PIECE))
    while count := file.readinto(buffer):
        digest.update(buffer[:count])
    return digest.hexdigest()


@contextmanager
def _reading() -> Iterator[None]:
    """Turn what a lost or failing file raises into what it means; what keeps the service from it is no damage."""
    try:
        yield
    except (FileNotFoundError, NotADirectoryError) as error:
        raise OriginalMissing from error
    except IsADirectoryError as error:
        raise OriginalCorrupt("In the place of the stored image is a folder.") from error
    except OSError as error:
        if error.errno == errno.EIO:
            raise OriginalCorrupt("The server's disk cannot read the stored image.") from error
        refusal = refusal_of(error)
        if refusal is None:
            raise
        log.error("original_not_read", reason=errno.errorcode.get(error.errno or 0), path=error.filename)
        raise refusal from error
