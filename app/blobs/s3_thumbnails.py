"""Thumbnails as objects of S3. One that cannot be written is not kept: it can be made again at any time."""

from __future__ import annotations

from typing import Any

from app.blobs.objects import delete_object, map_object_errors
from app.errors import ServiceError
from app.logs import Logger

log = Logger(__name__)


class S3Thumbnails:
    """Thumbnails as objects, named by the SHA-256 of the original they were made of."""

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
