"""The interface of a store of originals, which are named by their SHA-256: files of one machine, or objects of S3."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager
from io import FileIO
from typing import Protocol

from app.blobs.local import StagedBlob


class ThumbnailStore(Protocol):
    """Thumbnails by the SHA-256 of their originals; each can be made again, so that losing one is no error."""

    def read(self, sha256: str) -> bytes | None:
        """Return the thumbnail of an original, or None where none is kept or it cannot be read."""
        ...

    def write(self, sha256: str, data: bytes) -> None:
        """Keep a thumbnail, whole or not at all. Call it within the lock of the original."""
        ...

    def remove(self, sha256: str) -> bool:
        """Remove the thumbnail of an original, if there is one; return False where that is refused."""
        ...


class Blobs(Protocol):
    """The originals of one installation, and their thumbnails."""

    @property
    def thumbnails(self) -> ThumbnailStore:
        """The thumbnails of the originals."""
        ...

    def address(self, sha256: str) -> str:
        """Return where another process reads the original (`integrity.read_original`)."""
        ...

    def stage(self) -> StagedBlob:
        """Begin to receive a file."""
        ...

    def publish(self, staged: StagedBlob) -> None:
        """Put a received file under its name; on return it is durable. Call it within the lock."""
        ...

    def open(self, sha256: str, size: int) -> FileIO:
        """Return the original opened, once all of its bytes were found right; OriginalMissing, OriginalCorrupt."""
        ...

    def exists(self, sha256: str, size: int) -> bool:
        """Return whether the original is there, as long as it was when it came; its bytes are not read."""
        ...

    def existing(self, originals: Collection[tuple[str, int]]) -> set[tuple[str, int]]:
        """Return those of (sha256, size) for which `exists` holds."""
        ...

    def is_whole(self, sha256: str, size: int) -> bool:
        """Return whether the original is there with the bytes it came with; all of them are read."""
        ...

    def is_there(self, sha256: str) -> bool:
        """Return whether anything stands under the original's name."""
        ...

    def lock(self, sha256: str) -> AbstractContextManager[object]:
        """Keep `publish` and its row on one side, `remove` on the other: never a row without its original."""
        ...

    def stripe(self, sha256: str) -> int:
        """Return which lock is that of `sha256`; hashes of one stripe are locked together."""
        ...

    def remove(self, sha256: str) -> bool:
        """Delete an original and its thumbnail within `lock`; return False where that is refused."""
        ...

    def names(self) -> Iterator[list[tuple[str, float]]]:
        """Yield the originals there are, part by part, each with the time it was last written (s, wall clock)."""
        ...

    def prepare(self) -> int:
        """Make what uploads need, and remove what interrupted ones left; return how many files."""
        ...

    def clear_incoming(self) -> int:
        """Remove what uploads to this machine left that nobody is receiving any more; return how many files."""
        ...

    def free_bytes(self) -> int:
        """Return the free space of the disk that uploads are received on."""
        ...

    def check_access(self) -> None:
        """Raise OSError, with the folder, where this process may not read and write what uploads are received in."""
        ...

    def check_room(self, floor_bytes: int, wanted_bytes: int = 0) -> None:
        """Raise StorageFull where receiving `wanted_bytes` would leave less than `floor_bytes` free."""
        ...
