"""Keeping originals and rows in step.

Rows that name an original are deleted in one transaction with a record of what is to be removed (`record_removals`).
The files follow (`finish_removals`), at once and, where that failed, later. `services.maintenance.orphans` finds files
without a record. Both remove a file only within its lock and only where no measurement names it, so that an upload of
the same bytes always wins.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from itertools import groupby
from typing import TypeVar

import sqlalchemy as sa
from sqlalchemy import orm
from sqlalchemy.dialects import postgresql, sqlite

from app.blobs.interface import Blobs
from app.blobs.local import StagedBlob
from app.errors import ServiceError
from app.logs import Logger
from app.records.database import Database
from app.records.tables import Measurement, Removal

_TOGETHER = 1024
"""Hashes looked at in one go; the sixteen or so under one lock keep an upload of theirs waiting."""

_HASH = re.compile(r"[0-9a-f]{64}")

Item = TypeVar("Item")

log = Logger(__name__)


def remove_unreferenced(database: Database, blobs: Blobs, hashes: Sequence[str]) -> set[str]:
    """Delete those originals that no measurement of any session names, and return the hashes that are settled.

    Not settled are those of files that the system does not remove. What is no hash, from a damaged row, names no file.
    """
    named = [sha256 for sha256 in hashes if _HASH.fullmatch(sha256)]
    settled = set(hashes).difference(named)
    for _, guarded in groupby(sorted(named, key=blobs.stripe), key=blobs.stripe):
        together = list(guarded)
        with blobs.lock(together[0]):
            unnamed = _unnamed(database, together)
            settled.update(set(together) - set(unnamed), filter(blobs.remove, unnamed))
    return settled


def record_removals(records: orm.Session, which: sa.ColumnElement[bool]) -> list[str]:
    """Record that the originals of the measurements `which` are to be removed, and return their hashes.

    Call it before these rows are deleted, in the same transaction; `finish_removals` follows once that is committed.
    """
    hashes = (
        sa.select(Measurement.sha256, sa.literal(datetime.now(UTC), Removal.recorded_at.type))
        .where(which)
        .distinct()
        .order_by(Measurement.sha256)  # two deletions at once wait for one another in one order
    )
    insert = sqlite.insert if records.get_bind().dialect.name == "sqlite" else postgresql.insert
    statement = insert(Removal).from_select(["sha256", "recorded_at"], hashes)
    # A later time shows whoever completes the earlier record that there is more to do.
    statement = statement.on_conflict_do_update(
        index_elements=[Removal.sha256], set_={"recorded_at": statement.excluded.recorded_at}
    )
    return list(records.scalars(statement.returning(Removal.sha256)))


def finish_removals(
    database: Database,
    blobs: Blobs,
    hashes: Sequence[str] | None = None,
    *,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Remove the files of recorded removals, all or those of `hashes`; return how many records are settled.

    A record outlives a file that the system does not remove, and anything that is recorded meanwhile.
    """
    settled = 0
    for some in hashes_in(database, Removal.sha256) if hashes is None else in_pages(hashes):
        if stopped():
            break
        with database.read() as records:
            found = records.execute(
                sa.select(Removal.sha256, Removal.recorded_at).where(Removal.sha256.in_(some))
            ).all()
        removed = remove_unreferenced(database, blobs, [row.sha256 for row in found])
        done = [row for row in found if row.sha256 in removed]
        if len(done) < len(found):
            log.warning("removals_wait", files=len(found) - len(done))
        if done:
            with database.write() as records:
                records.execute(
                    sa.delete(Removal).where(
                        sa.tuple_(Removal.sha256, Removal.recorded_at).in_([tuple(row) for row in done])
                    )
                )
        settled += len(done)
    return settled


def finish_soon(database: Database, blobs: Blobs, hashes: Sequence[str]) -> None:
    """Finish removals for a request whose rows are gone: what fails now is logged and done by the next round."""
    try:
        finish_removals(database, blobs, hashes)
    except ServiceError as error:
        log.warning("removals_wait", code=error.code)


def restore_original(database: Database, blobs: Blobs, staged: StagedBlob) -> bool:
    """Put an original back that was lost or damaged on the disk, now that somebody sent it again; say whether it was.

    The stored file is read and hashed for that (0.5 ms per MB); one that is whole is not written anew.
    """
    sha256, size = staged.sha256, staged.size
    with blobs.lock(sha256):
        if blobs.is_whole(sha256, size):
            return False
        blobs.publish(staged)
        log.warning("original_restored", sha256=sha256)
        # Its rows may have been deleted since they were looked at.
        remove_unreferenced(database, blobs, [sha256])
        return True


def cleanup_after_failure(database: Database, blobs: Blobs, sha256: str) -> None:
    """Delete an original whose row could not be written; where even that fails, the sweep finds it.

    The next upload of the same bytes takes its place.
    """
    try:
        remove_unreferenced(database, blobs, [sha256])
    except ServiceError as error:
        log.warning("original_without_row", sha256=sha256, code=error.code)


def hashes_in(database: Database, column: orm.InstrumentedAttribute[str]) -> Iterator[Sequence[str]]:
    """Yield the hashes in a column, each once, page by page."""
    last = ""
    while True:
        with database.read() as records:
            some = records.scalars(
                sa.select(column).where(column > last).group_by(column).order_by(column).limit(_TOGETHER)
            ).all()
        if not some:
            return
        yield some
        last = some[-1]


def _unnamed(database: Database, hashes: Sequence[str]) -> list[str]:
    """Return those of `hashes` that no measurement names."""
    with database.read() as records:
        named = set(records.scalars(sa.select(Measurement.sha256).where(Measurement.sha256.in_(hashes))))
    return [sha256 for sha256 in hashes if sha256 not in named]


def in_pages(items: Sequence[Item]) -> Iterator[Sequence[Item]]:
    """Yield `items` in parts that one statement can name."""
    for start in range(0, len(items), _TOGETHER):
        yield items[start : start + _TOGETHER]
