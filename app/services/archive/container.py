"""The container of an archive: plain files of stated sizes, one after another, in a gzip-compressed tar.

Members are regular files with headers of POSIX.1-1988 (ustar) and nothing else: no links, no folders, no extended
headers. What is read is named by the manifest, never by the file, so that no name leads out of a folder; and a member
is read to its stated size, so that no stream that inflates without end fills memory or disk.
"""

from __future__ import annotations

import gzip
import hashlib
import tarfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Any, BinaryIO, Self

from isal import igzip

from app.errors import ArchiveRefused

PIECE = 1024 * 1024
_BLOCK = tarfile.BLOCKSIZE
_GZIP: Any = igzip.IGzipFile  # its constructor is not typed
_REGULAR = (tarfile.REGTYPE, tarfile.AREGTYPE)


class ArchiveWriter:
    """Writes members one after another to an open file."""

    def __init__(self, file: BinaryIO, made_at_s: int) -> None:
        self._made_at_s = made_at_s
        # Images are compressed already: the fastest level serves the rows.
        self._stream: IO[bytes] = _GZIP(
            filename="", mode="wb", compresslevel=1, fileobj=file, mtime=made_at_s
        )

    def add(self, name: str, size: int, pieces: Iterator[bytes]) -> None:
        """Add a member whose `pieces` make up `size` bytes."""
        header = tarfile.TarInfo(name)
        header.size, header.mtime, header.mode = size, self._made_at_s, 0o644
        self._stream.write(header.tobuf(tarfile.USTAR_FORMAT, "utf-8"))
        written = 0
        for piece in pieces:
            self._stream.write(piece)
            written += len(piece)
        if written != size:
            raise AssertionError(f"{name} has {written} bytes, not the {size} that were announced")
        self._stream.write(bytes(-size % _BLOCK))

    def add_bytes(self, name: str, content: bytes) -> None:
        """Add a member that is in memory."""
        self.add(name, len(content), iter((content,)))

    def close(self) -> None:
        """End the archive; the file it is written to stays open."""
        self._stream.write(bytes(2 * _BLOCK))
        self._stream.close()


class ArchiveReader:
    """Reads the members of an archive in their order. Raises ArchiveRefused where the file is not what it should be."""

    def __init__(self, path: Path) -> None:
        self._stream = gzip.open(path, "rb")  # noqa: SIM115 - closed by `__exit__`

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.close()

    def read(self, name: str, max_size: int) -> bytes:
        """Return the next member, which must have this name and at most `max_size` bytes."""
        size = self._header(name)
        if size > max_size:
            raise damaged(f"{name} has {size} bytes, more than any archive's")
        return b"".join(self._content(size))

    def copy(self, name: str, size: int, sha256: str, take: Callable[[bytes], object]) -> None:
        """Give the next member, which must have this name, size and hash, to `take` piece by piece."""
        found = self._header(name)
        if found != size:
            raise damaged(f"{name} has {found} bytes, and its manifest says {size}")
        digest = hashlib.sha256()
        for piece in self._content(size):
            digest.update(piece)
            take(piece)
        if digest.hexdigest() != sha256:
            raise damaged(f"{name} has other bytes than it was archived with")

    def require_end(self) -> None:
        """Read to the end, which must come now: of the tar and of the gzip stream with its checksum."""
        if any(self._exactly(_BLOCK)) or any(self._exactly(_BLOCK)):
            raise damaged("it holds more than its manifest names")
        if self._read(1):
            raise damaged("something follows its end")

    def _header(self, name: str) -> int:
        try:
            header = tarfile.TarInfo.frombuf(self._exactly(_BLOCK), "utf-8", "surrogateescape")
        except tarfile.HeaderError as error:
            raise damaged(f"{name} is missing where it should follow") from error
        if header.name != name or header.type not in _REGULAR or header.size < 0:
            raise damaged(f"another member stands where {name} should follow")
        return header.size

    def _content(self, size: int) -> Iterator[bytes]:
        left = size
        while left:
            piece = self._exactly(min(left, PIECE))
            left -= len(piece)
            yield piece
        self._exactly(-size % _BLOCK)

    def _exactly(self, size: int) -> bytes:
        content = self._read(size)
        if len(content) != size:
            raise damaged("it ends too early")
        return content

    def _read(self, size: int) -> bytes:
        try:
            return self._stream.read(size)
        except EOFError as error:
            raise damaged("it ends too early") from error
        except (gzip.BadGzipFile, zlib.error) as error:
            raise damaged("it is no gzip stream, or parts of it were changed") from error


def damaged(what: str) -> ArchiveRefused:
    """Return the refusal of an archive that is not what `archive_session` wrote."""
    return ArchiveRefused(
        "archive_damaged",
        f"The file is no whole session archive: {what}.",
        "Nothing was restored. Use another copy of the file, as `gridpose sessions archive` wrote it.",
    )
