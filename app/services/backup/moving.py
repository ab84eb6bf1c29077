"""An installation moved to another database and to S3: images first, each read back, then all rows in one transaction.

Interrupted, it is run again: images that were read back are known by a journal in the data folder, and rows are there
all or none. The former data stay as they are, and refuse to be opened as long as the folder says where they went.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import sqlalchemy as sa

from app.blobs import Blobs, S3Blobs
from app.errors import BackupRefused, InstallationRefused, OriginalCorrupt, OriginalMissing
from app.records import migrations
from app.records.database import Database
from app.records.rows import copy_rows, digest_rows
from app.records.tables import Installation, Measurement
from app.services.installation import backends
from app.services.installation.context import ServiceContext, alone, open_blobs
from app.settings import Settings

JOURNAL = "moving.journal"
_TOGETHER = 8
"""Images copied at once."""
_PIECE = 1024 * 1024

Progress = Callable[[int, int], None]
"""Called with the images done and in total."""


@dataclass(slots=True)
class Report:
    """What was moved: rows by table, images that are in the new place, and those that the old one no longer had."""

    installation_id: str
    rows: dict[str, int]
    originals: int = 0
    copied: int = 0
    missing: list[str] = field(default_factory=list)
    corrupt: list[str] = field(default_factory=list)


def move_installation(
    source: ServiceContext, database_url: str | None, blob_url: str | None, progress: Progress
) -> Report:
    """Copy an installation that nobody uses to a database, to a bucket, or to both; None leaves that part in place.

    Afterwards the source is marked as moved. Raises InstallationRefused, BackupRefused, ServiceError.
    """
    settings = source.settings
    target = settings.model_copy(
        update={
            "database_url": database_url or settings.database_url,
            "blob_url": blob_url or settings.blob_url,
        }
    )
    if (target.database_url, target.blob_url) == (settings.database_url, settings.blob_url):
        raise BackupRefused(
            "nothing_to_move",
            "The installation is there already.",
            "Name another database with --database-url, or a bucket with --blob-url.",
        )
    with alone(settings, source.database), source.database.read() as records:
        row = records.get_one(Installation, 1)
        database = Database(target.effective_database_url) if database_url else source.database
        try:
            blobs = open_blobs(target, database)
            if database is not source.database:
                _prepare_database(database, target, row.id)
            if isinstance(blobs, S3Blobs) and blob_url is not None:
                _prepare_bucket(blobs, blob_url, row.id)
            report = Report(row.id, {})
            if blob_url is not None:
                _copy_originals(source, blobs, settings.data_dir / JOURNAL, report, progress)
            if database is not source.database:
                report.rows = _move_rows(source.database, database)
        finally:
            if database is not source.database:
                database.dispose()
    backends.mark_moved(settings, target)
    (settings.data_dir / JOURNAL).unlink(missing_ok=True)
    return report


def _prepare_database(database: Database, target: Settings, installation_id: str) -> None:
    """Give the target this program's schema; raise where it holds anything but an earlier run's rows."""
    if not database.is_sqlite:
        backends.require_direct(database)
        backends.require_clock(database)
    migrations.require_known(migrations.current_revision(database))
    migrations.upgrade(database, target.data_dir, copy_first=False)
    with database.read() as records:
        row = records.get(Installation, 1)
        has_rows = records.scalar(sa.select(sa.exists().where(Measurement.id.is_not(None))))
    if row is not None and row.id != installation_id:
        raise InstallationRefused(
            "installation_mismatch",
            f"The database belongs to installation {row.id}, the data to be moved to {installation_id}.",
            "Name an empty database.",
        )
    if row is None and has_rows:
        raise BackupRefused("restore_not_empty", "The database is not empty.", "Name an empty database.")


def _prepare_bucket(blobs: S3Blobs, url: str, installation_id: str) -> None:
    backends.require_bucket(blobs, url)
    backends.write_id(blobs, installation_id)
    stored = backends.stored_id(blobs)
    if stored != installation_id:
        raise InstallationRefused(
            "installation_mismatch",
            f"{url} belongs to installation {stored}, the data to be moved to {installation_id}.",
            "Name another bucket or prefix.",
        )


def _copy_originals(
    source: ServiceContext, blobs: Blobs, journal: Path, report: Report, progress: Progress
) -> None:
    """Copy every original that a row names and read it back; those of the journal were read back before."""
    with source.database.read() as records:
        statement = sa.select(Measurement.sha256, Measurement.bytes).distinct().order_by(Measurement.sha256)
        named = [(row.sha256, row.bytes) for row in records.execute(statement)]
    done = _read_journal(journal, blobs)
    with journal.open("a", encoding="ascii") as file, ThreadPoolExecutor(_TOGETHER) as threads:
        rest = [original for original in named if original[0] not in done]
        report.originals = len(named) - len(rest)
        progress(report.originals, len(named))
        for (sha256, _), state in zip(
            rest, threads.map(lambda original: _copy(source.blobs, blobs, *original), rest), strict=True
        ):
            if state in ("missing", "corrupt"):
                getattr(report, state).append(sha256)
                continue
            report.copied += state == "copied"
            report.originals += 1
            file.write(sha256 + "\n")
            file.flush()
            progress(report.originals, len(named))


def _copy(source: Blobs, target: Blobs, sha256: str, size: int) -> str:
    """Return `there`, `copied`, `missing` or `corrupt`; what is in the target afterwards was read and hashed."""
    if target.is_whole(sha256, size):
        return "there"
    try:
        with source.open(sha256, size) as original:
            staged = target.stage()
            try:
                while piece := original.read(_PIECE):
                    staged.write(piece)
                with target.lock(sha256):
                    target.publish(staged)
            finally:
                staged.discard()
    except OriginalMissing:
        return "missing"
    except OriginalCorrupt:
        return "corrupt"
    if not target.is_whole(sha256, size):
        raise BackupRefused(
            "copy_differs",
            f"The copy of {sha256} does not have the bytes that were written.",
            "Check the object store, then run the command again.",
        )
    return "copied"


def _read_journal(journal: Path, blobs: Blobs) -> set[str]:
    """Return the hashes that an earlier run to the same place read back; begin anew where it went elsewhere."""
    first = json.dumps({"to": blobs.address("0" * 64)})
    try:
        lines = journal.read_text(encoding="ascii").splitlines()
    except (FileNotFoundError, UnicodeDecodeError):
        lines = []
    if lines[:1] != [first]:
        journal.write_text(first + "\n", encoding="ascii")
        return set()
    return {line for line in lines[1:] if len(line) == 64}


def _move_rows(source: Database, target: Database) -> dict[str, int]:
    """Copy all rows in one transaction unless an earlier run did, compare both, and return how many rows there are."""
    with source.snapshot() as given, target.engine.begin() as taken:
        if taken.scalar(sa.select(sa.func.count()).select_from(Installation.__table__)) == 0:
            copy_rows(given, taken)
        before, after = digest_rows(given), digest_rows(taken)
        differing = sorted(name for name in before if before[name] != after.get(name))
        if differing:
            raise BackupRefused(
                "copy_differs",
                f"The rows of {', '.join(differing)} differ from those that were to be moved.",
                "Nothing of this run was kept in the database. Name an empty database, then run the command again.",
            )
    return {name: count for name, (count, _) in before.items()}
