"""Originals as objects of S3, for any number of services and workers; durable before an upload is acknowledged.

An upload is received on the service's own disk, then put under its hash in one request; large ones in parts. Nothing
is ever renamed or changed: an object holds the bytes of its name or is damaged, which every reading finds out. Locks
between services are the database's.
"""

from __future__ import annotations

import hashlib
import re
import secrets
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from io import FileIO
from pathlib import Path
from typing import Any

from app.blobs.local import LocalBlobs, StagedBlob, map_storage_errors
from app.blobs.objects import delete_object, map_object_errors, split_address, store_of
from app.blobs.thumbnails import S3Thumbnails
from app.errors import OriginalCorrupt, OriginalMissing

_STRIPES = 4096
"""Locks between services: two uploads of different images that share one wait for each other's put."""
ONE_REQUEST_BYTES = 16 * 1024 * 1024
"""Larger uploads are put in parts, which S3 does without the condition that nothing is there yet."""
_PART_BYTES = 8 * 1024 * 1024
_TOGETHER = 16
"""Questions asked at once where many originals are looked for."""
_NAME = re.compile(r"[0-9a-f]{64}")
Guard = Callable[[int], AbstractContextManager[None]]
"""Excludes other processes from what a number stands for."""


class S3Blobs:
    """The originals of one installation in a bucket, and their thumbnails."""

    def __init__(self, url: str, spool: Path, guard: Guard) -> None:
        bucket, prefix = split_address(url)
        self._bucket = bucket
        self._prefix = prefix.strip("/") + "/" if prefix.strip("/") else ""
        self._store = store_of(bucket)
        self._spool = LocalBlobs(spool)
        self._incoming = spool / "incoming"
        self._guard = guard
        self._locks = tuple(threading.RLock() for _ in range(_STRIPES))
        self._depths = [0] * _STRIPES
        self.thumbnails = S3Thumbnails(self._store, self._prefix)

    def address(self, sha256: str) -> str:
        """Return where another process reads the original."""
        return f"{self._bucket}/{self._key(sha256)}"

    def stage(self) -> StagedBlob:
        """Begin to receive a file, on this machine's disk."""
        return self._spool.stage()

    def publish(self, staged: StagedBlob) -> None:
        """Put a received file under its name; on return S3 has acknowledged it. Call it within the lock."""
        import obstore
        from obstore.exceptions import AlreadyExistsError

        staged.close()
        key = self._key(staged.sha256)
        if staged.size > ONE_REQUEST_BYTES:
            with map_object_errors("put"):
                obstore.put(
                    self._store,
                    key,
                    staged.path,
                    use_multipart=True,
                    chunk_size=_PART_BYTES,
                    max_concurrency=4,
                )
            return
        source = staged.source
        data = source if isinstance(source, bytes) else source.read_bytes()
        with map_object_errors("put"):
            try:
                obstore.put(self._store, key, data, mode="create")
            except AlreadyExistsError:
                # Somebody's earlier upload, or our own whose answer was lost; or one that is damaged.
                if not self.is_whole(staged.sha256, staged.size):
                    obstore.put(self._store, key, data, use_multipart=False)

    def open(self, sha256: str, size: int) -> FileIO:
        """Return the original opened, once all of its bytes were found right; OriginalMissing, OriginalCorrupt.

        It is a copy on this machine's disk without a name, gone when it is closed.
        """
        with map_storage_errors():
            file = tempfile.TemporaryFile(dir=self._incoming, buffering=0)  # noqa: SIM115 - the caller closes it
        assert isinstance(file, FileIO)
        digest, received = hashlib.sha256(), 0
        try:
            for chunk in self._chunks(sha256):
                digest.update(chunk)
                received += len(chunk)
                with map_storage_errors():
                    file.write(chunk)
            if digest.hexdigest() != sha256 or received != size:
                raise OriginalCorrupt
            file.seek(0)
        except BaseException:
            file.close()
            raise
        return file

    def exists(self, sha256: str, size: int) -> bool:
        """Return whether the original is there, as long as it was when it came; its bytes are not read."""
        found = self._head(sha256)
        return found is not None and found["size"] == size

    def existing(self, originals: Collection[tuple[str, int]]) -> set[tuple[str, int]]:
        """Return those of (sha256, size) for which `exists` holds; several are asked about at once."""
        if not originals:
            return set()
        wanted = list(originals)
        with ThreadPoolExecutor(min(_TOGETHER, len(wanted)), thread_name_prefix="head") as threads:
            found = list(threads.map(lambda original: self.exists(*original), wanted))
        return {original for original, there in zip(wanted, found, strict=True) if there}

    def is_whole(self, sha256: str, size: int) -> bool:
        """Return whether the original is there with the bytes it came with; all of them are read."""
        if not self.exists(sha256, size):
            return False
        digest = hashlib.sha256()
        try:
            for chunk in self._chunks(sha256):
                digest.update(chunk)
        except OriginalMissing:
            return False
        return digest.hexdigest() == sha256

    def is_there(self, sha256: str) -> bool:
        """Return whether anything stands under the original's name."""
        return self._head(sha256) is not None

    @contextmanager
    def lock(self, sha256: str) -> Iterator[None]:
        """Keep `publish` and its row on one side, `remove` on the other, also those of other services."""
        stripe = self.stripe(sha256)
        with self._locks[stripe]:
            if self._depths[stripe]:  # this thread has it already
                yield
                return
            with self._guard(stripe):
                self._depths[stripe] += 1
                try:
                    yield
                finally:
                    self._depths[stripe] -= 1

    def stripe(self, sha256: str) -> int:
        """Return which lock is that of `sha256`; hashes of one stripe are locked together."""
        return int(sha256[:8], 16) % _STRIPES

    def remove(self, sha256: str) -> bool:
        """Delete an original that no row names any more, its thumbnail first; call it within `lock`.

        Return False where S3 refuses; the log says why.
        """
        return self.thumbnails.remove(sha256) and delete_object(self._store, self._key(sha256))

    def names(self) -> Iterator[list[tuple[str, float]]]:
        """Yield the originals there are, part by part, each with the time it was put (s, the store's clock)."""
        import obstore

        for number in range(256):
            with map_object_errors("list"):
                listed: list[Any] = [
                    found
                    for some in obstore.list(self._store, prefix=f"{self._prefix}originals/{number:02x}")
                    for found in some
                ]
            found = [(item["path"].rpartition("/")[2], item["last_modified"].timestamp()) for item in listed]
            found = [item for item in found if _NAME.fullmatch(item[0])]
            if found:
                yield sorted(found)

    def prepare(self) -> int:
        """Remove what interrupted uploads left on this machine's disk; return how many files."""
        return self.clear_incoming()

    def clear_incoming(self) -> int:
        """Remove what uploads to this machine left that nobody is receiving any more; return how many files."""
        return self._spool.clear_incoming()

    def free_bytes(self) -> int:
        """Return the free space of the disk that uploads are received on."""
        return self._spool.free_bytes()

    def check_access(self) -> None:
        """Raise OSError, with the folder, where this process may not read and write what uploads are received in."""
        self._spool.check_access()

    def check_room(self, floor_bytes: int, wanted_bytes: int = 0) -> None:
        """Raise StorageFull where receiving `wanted_bytes` would leave less than `floor_bytes` free."""
        self._spool.check_room(floor_bytes, wanted_bytes)

    def read_document(self, name: str) -> bytes | None:
        """Return a small object of the installation's own, None where it does not exist."""
        import obstore

        try:
            with map_object_errors("read"):
                return bytes(obstore.get(self._store, self._prefix + name).bytes())
        except FileNotFoundError:
            return None

    def create_document(self, name: str, content: bytes) -> bool:
        """Write a small object of the installation's own; return False where it is there already."""
        import obstore
        from obstore.exceptions import AlreadyExistsError

        with map_object_errors("put"):
            try:
                obstore.put(self._store, self._prefix + name, content, mode="create")
            except AlreadyExistsError:
                return False
        return True

    def probe(self) -> bool:
        """Write, read and remove an object as uploads do; return whether the store keeps the first of two creations.

        Raises Unavailable where it refuses any of it.
        """
        name = f"probe/{secrets.token_hex(8)}"
        try:
            first = self.create_document(name, b"first")
            second = self.create_document(name, b"second")
            return first and not second and self.read_document(name) == b"first"
        finally:
            delete_object(self._store, self._prefix + name)

    def _key(self, sha256: str) -> str:
        return f"{self._prefix}originals/{sha256[:2]}/{sha256}"

    def _head(self, sha256: str) -> Any:
        import obstore

        try:
            with map_object_errors("head"):
                return obstore.head(self._store, self._key(sha256))
        except FileNotFoundError:
            return None

    def _chunks(self, sha256: str) -> Iterator[bytes]:
        import obstore

        try:
            with map_object_errors("read"):
                for chunk in obstore.get(self._store, self._key(sha256)).stream(1024 * 1024):
                    yield bytes(chunk)
        except FileNotFoundError as error:
            raise OriginalMissing from error
