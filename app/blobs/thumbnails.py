"""Thumbnails, as files or as objects of S3, named by the SHA-256 of the original they were made of.

A thumbnail can be made again at any time: it is not in backups, and one that cannot be written is not kept.
"""

from __future__ import annotations

import errno
import secrets
from contextlib import suppress
from pathlib import Path
from typing import Any

from app.blobs.durable import remove_file
from app.blobs.objects import delete_object, map_object_errors
from app.errors import ServiceError
from app.logs import Logger

log = Logger(__name__)


def thumbnail_path(root: Path, sha256: str) -> Path:
    """Return where, below a folder of thumbnails, that of this original lies."""
    return root / sha256[:2] / f"{sha256}.webp"


class Thumbnails:
    """The thumbnails of one data folder."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def read(self, sha256: str) -> bytes | None:
        """Return the thumbnail of an original, or None where none is kept or it cannot be read."""
        try:
            return thumbnail_path(self.root, sha256).read_bytes() or None
        except OSError:
            return None

    def write(self, sha256: str, data: bytes) -> None:
        """Keep a thumbnail; it appears whole or not at all. Call it within the lock of the original."""
        path = thumbnail_path(self.root, sha256)
        temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(data)
            temporary.replace(path)
        except OSError as error:
            log.warning("thumbnail_not_kept", reason=errno.errorcode.get(error.errno or 0))
            with suppress(OSError):  # what kept it from being written may keep it from being removed
                temporary.unlink()

    def remove(self, sha256: str) -> bool:
        """Remove the thumbnail of an original, if there is one; return False where the system refuses."""
        return remove_file(thumbnail_path(self.root, sha256))


class S3Thumbnails:
    """The thumbnails of one bucket."""

    def __init__(self, store: Any, prefix: str) -> None:
        self._store, self._prefix = store, prefix

    def read(self, sha256: str) -> bytes | None:
        """Return the thumbnail of an original, or None where none is kept or it cannot be read."""
        import obstore

        try:
            with map_object_errors("read"):
                return bytes(obstore.get(self._store, self._key(sha256)).bytes()) or None
        except (FileNotFoundError, ServiceError):
            return None

    def write(self, sha256: str, data: bytes) -> None:
        """Keep a thumbnail; it appears whole or not at all. Call it within the lock of the original."""
        import obstore

        try:
            with map_object_errors("put"):
                obstore.put(self._store, self._key(sha256), data)
        except ServiceError as error:
            log.warning("thumbnail_not_kept", reason=error.code)

    def remove(self, sha256: str) -> bool:
        """Remove the thumbnail of an original, if there is one; return False where S3 refuses."""
        return delete_object(self._store, self._key(sha256))

    def _key(self, sha256: str) -> str:
        return f"{self._prefix}thumbnails/{sha256[:2]}/{sha256}.webp"
