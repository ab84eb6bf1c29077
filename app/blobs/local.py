"""Originals as files, named by their SHA-256; durable before an upload is acknowledged.

An upload is written to `incoming/`, fsynced, renamed into place, and its folder is fsynced. Only then is the row
written. A crash in between leaves a file without a row: harmless, since the next upload of the same bytes takes its
place, and removed by the sweep (`services/maintenance/orphans.py`), as are files left in `incoming/`.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from io import FileIO
from pathlib import Path

from app.blobs.durable import begin_writing, remove_file, sync_folder
from app.blobs.integrity import is_whole, open_original
from app.blobs.thumbnails import Thumbnails
from app.errors import StorageFull, StorageUnusable, refusal_of
from app.logs import Logger

_STRIPES = 64
_PREFIXES = tuple(f"{number:02x}" for number in range(256))
_NAME = re.compile(r"[0-9a-f]{64}")

log = Logger(__name__)


class StagedBlob:
    """A file being received: hashed while it is written, not yet under its name; made when the first bytes come.

    `ended` is called once when nothing will be written to it any more.
    """

    def __init__(self, path: str, ended: Callable[[], None]) -> None:
        self._path = path
        self.size = 0
        self._hash = hashlib.sha256()
        self._digest: str | None = None
        self._ended = ended
        self._file: FileIO | None = None
        self._content: bytes | None = None
        self._published = False

    def write(self, chunk: bytes) -> None:
        """Append `chunk`."""
        with map_storage_errors():
            if self._file is None:
                self._file = FileIO(self._path, "x")
            rest = memoryview(chunk)
            while rest:
                rest = rest[self._file.write(rest) :]
            begin_writing(self._file.fileno(), self.size, len(chunk))
        self._hash.update(chunk)
        self._digest = None
        self._content = chunk if self.size == 0 else None
        self.size += len(chunk)

    @property
    def path(self) -> Path:
        """Where the file lies."""
        return Path(self._path)

    @property
    def sha256(self) -> str:
        """The hash of all bytes so far, 64 lower-case hex digits."""
        if self._digest is None:
            self._digest = self._hash.hexdigest()
        return self._digest

    @property
    def source(self) -> bytes | Path:
        """What to read the bytes from: themselves where they came in one piece, else the file."""
        return self.path if self._content is None else self._content

    def close(self) -> None:
        """Write nothing more; the bytes need not have reached the disk."""
        if self._file is not None:
            self._file.close()

    def flush(self) -> None:
        """Bring the bytes to the disk itself."""
        assert self._file is not None, "nothing was written"
        with map_storage_errors():
            os.fsync(self._file.fileno())
        self._file.close()

    def move(self, target: str) -> None:
        """Give the file its name, in place of any that has it."""
        os.replace(self._path, target)  # noqa: PTH105 - each upload does
        self._published = True

    def discard(self) -> None:
        """Forget the file; harmless once it has been published. What cannot be removed now, the sweep removes later."""
        if self._file is not None:
            try:
                self._file.close()
            except OSError as error:
                log.warning(
                    "upload_not_closed", reason=errno.errorcode.get(error.errno or 0), path=self._path
                )
            if not self._published:
                remove_file(self.path)
        self._ended()


def original_path(root: Path, sha256: str) -> Path:
    """Return where, below a folder of originals, the one with this hash lies."""
    return root / sha256[:2] / sha256


class LocalBlobs:
    """The originals of one data folder, and their thumbnails in the folder next to them."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._root = str(root)
        self.thumbnails = Thumbnails(root.parent / "thumbnails")
        self._incoming = root / "incoming"
        self._incoming.mkdir(parents=True, exist_ok=True)
        self._locks = tuple(threading.RLock() for _ in range(_STRIPES))
        self._receiving: set[str] = set()

    def path(self, sha256: str) -> Path:
        """Return where the original with this hash lies, or would lie."""
        return original_path(self.root, sha256)

    def address(self, sha256: str) -> str:
        """Return the path of the original, as another process takes it."""
        return str(self.path(sha256))

    def open(self, sha256: str, size: int) -> FileIO:
        """Return the original opened, once all of its bytes were found right; OriginalMissing, OriginalCorrupt."""
        return open_original(self.path(sha256), sha256, size)

    def stage(self) -> StagedBlob:
        """Begin to receive a file."""
        name = secrets.token_hex(16)
        self._receiving.add(name)  # before there is a file, or the sweep could take it for one left over
        return StagedBlob(f"{self._root}/incoming/{name}", partial(self._receiving.discard, name))

    def is_there(self, sha256: str) -> bool:
        """Return whether there is a file of this name, whatever it holds."""
        return os.path.exists(self._place(sha256))  # noqa: PTH110 - each upload asks

    def exists(self, sha256: str, size: int) -> bool:
        """Return whether the original is there, as long as it was when it came; its bytes are not read."""
        try:
            return self.path(sha256).stat().st_size == size
        except (FileNotFoundError, NotADirectoryError):
            return False

    def existing(self, originals: Collection[tuple[str, int]]) -> set[tuple[str, int]]:
        """Return those of (sha256, size) for which `exists` holds."""
        return {original for original in originals if self.exists(*original)}

    def is_whole(self, sha256: str, size: int) -> bool:
        """Return whether the original is there with the bytes it came with; all of them are read."""
        return is_whole(self.path(sha256), sha256, size)

    def publish(self, staged: StagedBlob) -> None:
        """Put a received file under its name; on return it survives a power cut."""
        folder = f"{self._root}/{staged.sha256[:2]}"
        staged.flush()
        with map_storage_errors():
            try:
                self._move(staged)
            except FileNotFoundError:  # a folder that was there at the start is gone
                Path(folder).mkdir(exist_ok=True)
                sync_folder(self._root)
                self._move(staged)
            sync_folder(folder)

    def _place(self, sha256: str) -> str:
        """Return what `path` does, as text: each upload needs it several times."""
        return f"{self._root}/{sha256[:2]}/{sha256}"

    def _move(self, staged: StagedBlob) -> None:
        try:
            # An identical file may be there already; replacing it is as good as keeping it, and surely whole.
            staged.move(self._place(staged.sha256))
        except PermissionError:
            # Windows replaces no file that is open, as one that is being measured is.
            if not self.is_whole(staged.sha256, staged.size):
                raise

    def lock(self, sha256: str) -> AbstractContextManager[object]:
        """Keep `publish` and its row on one side, `remove` on the other: never a row without its file.

        One process at a time serves uploads from a data folder (`head.lock`), so a lock in memory is enough.
        """
        return self._locks[self.stripe(sha256)]

    def stripe(self, sha256: str) -> int:
        """Return which lock is that of `sha256`; hashes of one stripe are locked together."""
        return int(sha256[:8], 16) % _STRIPES

    def remove(self, sha256: str) -> bool:
        """Delete an original that no row names any more, its thumbnail first; call it within `lock`.

        Return False where the system refuses, as Windows does while the file is open; the log says why.
        """
        return self.thumbnails.remove(sha256) and remove_file(self.path(sha256))

    def names(self) -> Iterator[list[tuple[str, float]]]:
        """Yield the originals there are, folder by folder, each with the time it was last written (s, wall clock)."""
        for prefix in _PREFIXES:
            found = []
            try:
                with os.scandir(f"{self._root}/{prefix}") as entries:
                    for entry in entries:
                        if _NAME.fullmatch(entry.name) and entry.name.startswith(prefix):
                            with suppress(FileNotFoundError):
                                found.append((entry.name, entry.stat(follow_symlinks=False).st_mtime))
            except (FileNotFoundError, NotADirectoryError):
                continue
            if found:
                yield sorted(found)

    def prepare(self) -> int:
        """Make every folder, once and durably, and remove what interrupted uploads left; return how many files.

        With the folders there beforehand, an upload has one folder fewer to bring to the disk.
        """
        there = set(os.listdir(self._root))  # noqa: PTH208 - names alone
        for prefix in _PREFIXES:
            if prefix not in there:
                (self.root / prefix).mkdir(exist_ok=True)
        sync_folder(self.root)
        return self.clear_incoming()

    def clear_incoming(self) -> int:
        """Remove what uploads left that nobody is receiving any more; return how many files went.

        Uploads in progress are known in memory: no clock decides, and one process at a time receives (`head.lock`).
        """
        removed = 0
        with os.scandir(self._incoming) as entries:
            for entry in entries:
                if entry.name not in self._receiving and entry.is_file(follow_symlinks=False):
                    removed += remove_file(self._incoming / entry.name)
        return removed

    def free_bytes(self) -> int:
        """Return the free space of the disk the originals lie on."""
        return shutil.disk_usage(self._root).free

    def check_access(self) -> None:
        """Raise OSError, with the folder, where this process may not read and write the originals."""
        for folder in (self.root, self._incoming):
            folder.stat()
            if not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, "no permission, or a read-only disk", str(folder))

    def check_room(self, floor_bytes: int, wanted_bytes: int = 0) -> None:
        """Raise StorageFull where storing `wanted_bytes` would leave less than `floor_bytes` free."""
        with map_storage_errors():
            free = self.free_bytes()
        if free - wanted_bytes < floor_bytes:
            raise StorageFull("Free disk space is below its floor.")


@contextmanager
def map_storage_errors() -> Iterator[None]:
    """Turn a write that failed into a refusal: the client may try again, the log says what the disk said."""
    try:
        yield
    except OSError as error:
        log.error("original_not_written", reason=errno.errorcode.get(error.errno or 0), path=error.filename)
        raise (refusal_of(error) or StorageUnusable.of(error)) from error
