"""Checks of the originals: every file has the SHA-256 of its name, and rows and files agree.

A service may run meanwhile and add or delete images: whatever seems wrong is checked again at the end. Where the
operating system permits, files are read from the disk rather than from its cache.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import sqlalchemy as sa

from app.blobs.integrity import hash_of
from app.blobs.local import LocalBlobs
from app.records.database import Database
from app.records.migrations import current_revision, head_revision
from app.records.tables import Measurement
from app.services.inspection import files
from app.services.inspection.check_result import CheckResult, failed, ok, warn
from app.services.maintenance.orphans import GRACE_S
from app.services.originals import hashes_in, in_pages
from app.settings import Settings

_MAX_LISTED = 20
"""Files listed of each kind; the others are counted."""
_UPLOAD_AGAIN = (
    "Move the file away if there is one. Then run `gridpose upload` of the image's folder to that session: it sends "
    "missing images, and failed measurements of them are repeated. Or restore the file from a backup and retry the "
    "measurement. Check the disk."
)

Progress = Callable[[int, int], None]
"""Called with the bytes read so far and in total."""


@dataclass(slots=True)
class _Scan:
    """Files that were read, and those that seem wrong."""

    files: int = 0
    bytes: int = 0
    corrupt: list[str] = field(default_factory=list)
    unreadable: dict[str, str] = field(default_factory=dict)
    orphaned: list[str] = field(default_factory=list)


def check(settings: Settings, progress: Progress) -> Iterator[CheckResult]:
    """Hash every original and compare files with rows."""
    root = settings.data_dir / "originals"
    if root.is_dir() and files.is_read_only(root):
        yield warn("not checked: their disk is read-only", "See the checks of the data folder.")
        return
    database = Database(settings.effective_database_url)
    try:
        if not root.is_dir() or current_revision(database) != head_revision():
            yield warn(
                "not checked: nothing is stored yet, or the database has another schema",
                "Start the service once, then repeat this check.",
            )
            return
        yield from _compare(LocalBlobs(root), database, progress)
    finally:
        database.dispose()


def _compare(blobs: LocalBlobs, database: Database, progress: Progress) -> Iterator[CheckResult]:
    started = time.perf_counter()
    scan = _read_all(blobs, database, progress)
    seconds = max(time.perf_counter() - started, 1e-9)
    missing = list(_missing(blobs, database))
    corrupt = [name for name in scan.corrupt if _is_corrupt(blobs, name)]
    yield ok(
        f"{scan.files} files, {scan.bytes / 1e6:.0f} MB read at {scan.bytes / 1e6 / seconds:.0f} MB/s; "
        f"{scan.files - len(corrupt) - len(scan.unreadable)} have the SHA-256 of their names"
    )
    yield from _listed(
        [(name, f"is corrupt: its bytes have another SHA-256{_named(database, name)}") for name in corrupt],
        _UPLOAD_AGAIN,
    )
    yield from _listed(
        [(n, f"cannot be read ({reason}){_named(database, n)}") for n, reason in scan.unreadable.items()],
        f"Check that the service's user may read it. {_UPLOAD_AGAIN}",
    )
    yield from _listed([(name, f"is missing{_named(database, name)}") for name in missing], _UPLOAD_AGAIN)
    yield from _orphans(blobs, database, scan.orphaned)


def _read_all(blobs: LocalBlobs, database: Database, progress: Progress) -> _Scan:
    """Hash every file, folder by folder, and collect those that no row refers to."""
    total = sum(_size(blobs, name) for found in blobs.names() for name, _ in found)
    scan = _Scan()
    for found in blobs.names():
        names = [name for name, _ in found]
        for page in in_pages(names):
            named = _referenced(database, page)
            scan.orphaned += [name for name in page if name not in named]
        for name in names:
            try:
                with blobs.path(name).open("rb", buffering=0) as file:
                    size = os.fstat(file.fileno()).st_size
                    if hasattr(os, "posix_fadvise"):
                        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
                    if hash_of(file) != name:
                        scan.corrupt.append(name)
            except FileNotFoundError:
                continue  # deleted meanwhile; it is reported as missing where a row still refers to it
            except OSError as error:
                scan.unreadable[name] = error.strerror or str(error)
                size = 0
            scan.files += 1
            scan.bytes += size
            progress(scan.bytes, total)
    return scan


def _missing(blobs: LocalBlobs, database: Database) -> Iterator[str]:
    """Yield the hashes of rows whose files do not exist."""
    for page in hashes_in(database, Measurement.sha256):
        gone = [name for name in page if not blobs.path(name).is_file()]
        still_named = _referenced(database, gone)  # the session may have been deleted since
        yield from (name for name in gone if name in still_named)


def _is_corrupt(blobs: LocalBlobs, name: str) -> bool:
    """Return whether a file's present hash differs from its name: it may have been replaced or deleted since."""
    try:
        with blobs.path(name).open("rb", buffering=0) as file:
            return hash_of(file) != name
    except FileNotFoundError:
        return False


def _orphans(blobs: LocalBlobs, database: Database, names: list[str]) -> Iterator[CheckResult]:
    """Report files that no row refers to: interrupted uploads and deletions leave them to the service's sweep."""
    old: list[str] = []
    recent: list[str] = []
    still_named: set[str] = set()
    for page in in_pages(names):
        still_named |= _referenced(database, page)
    for name in names:
        path = blobs.path(name)
        if name in still_named or not path.is_file():
            continue
        (old if time.time() - path.stat().st_mtime > 2 * GRACE_S else recent).append(name)
    if recent:
        size = sum([_size(blobs, name) for name in recent]) / 1e6
        yield warn(
            f"{len(recent)} files, {size:.0f} MB, that no measurement refers to",
            "Nothing to do where they are few: the running service removes them a day after it found them.",
        )
    yield from _listed(
        [(name, f"is orphaned: no measurement refers to it ({_size(blobs, name)} bytes)") for name in old],
        "The running service removes a few such files a day after it found them; its log reports failures "
        "(file_not_removed). It keeps a large number of them (orphans_kept): the database may be empty or an older "
        "copy. Restore the database that belongs to them, or remove the files.",
    )


def _listed(found: list[tuple[str, str]], advice: str) -> Iterator[CheckResult]:
    for name, what in found[:_MAX_LISTED]:
        yield failed(f"{name[:2]}/{name} {what}", advice)
    if len(found) > _MAX_LISTED:
        yield failed(f"and {len(found) - _MAX_LISTED} more of this kind", advice)


def _named(database: Database, name: str) -> str:
    """Return the measurements of an original, as text that follows its problem."""
    with database.read() as records:
        rows = records.execute(
            sa.select(Measurement.id, Measurement.session_id, Measurement.pose_id, Measurement.filename)
            .where(Measurement.sha256 == name)
            .order_by(Measurement.id)
            .limit(_MAX_LISTED)
        ).all()
    if not rows:
        return "; no measurement refers to it"
    return "; " + ", ".join(
        f"measurement {row.id} (session {row.session_id}, pose {row.pose_id}"
        + (f", {row.filename})" if row.filename else ")")
        for row in rows
    )


def _referenced(database: Database, names: Sequence[str]) -> set[str]:
    with database.read() as records:
        return set(records.scalars(sa.select(Measurement.sha256).where(Measurement.sha256.in_(names))))


def _size(blobs: LocalBlobs, name: str) -> int:
    try:
        return blobs.path(name).stat().st_size
    except FileNotFoundError:
        return 0
