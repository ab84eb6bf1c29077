"""Checks of the bucket: it can be written and read, keeps what came first, is this installation's, and has its images.

The deep check reads every image that a row names, eight at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError

from app.blobs import S3Blobs
from app.errors import InstallationRefused, ServiceError
from app.records.database import Database
from app.records.tables import Installation, Measurement
from app.services.inspection.check_result import CheckResult, failed, ok, warn
from app.services.installation.backends import require_bucket, stored_id
from app.services.installation.context import open_blobs
from app.settings import Settings

_MAX_LISTED = 20
_SLOW_S = 0.2
_TOGETHER = 8

Progress = Callable[[int, int], None]
"""Called with the bytes read so far and in total."""


def check(settings: Settings) -> Iterator[CheckResult]:
    """Check the bucket of GRIDPOSE_BLOB_URL by writing, reading and removing small objects."""
    database = Database(settings.effective_database_url)
    try:
        blobs = open_blobs(settings, database)
        assert isinstance(blobs, S3Blobs)
        assert settings.blob_url is not None
        started = time.perf_counter()
        try:
            require_bucket(blobs, settings.blob_url)
        except InstallationRefused as error:
            yield failed(error.detail, error.advice)
            return
        seconds = (time.perf_counter() - started) / 4.0  # two puts, a get and a delete
        if seconds > _SLOW_S:
            yield warn(
                f"can be written, but a request takes {1000 * seconds:.0f} ms",
                "Every upload waits for one: use a store in the same data centre.",
            )
        else:
            yield ok(f"can be written, read and removed from; a request takes {1000 * seconds:.0f} ms")
        yield ok("keeps the first of two objects of one name")
        yield _bound(blobs, database)
    finally:
        database.dispose()


def _bound(blobs: S3Blobs, database: Database) -> CheckResult:
    try:
        with database.read() as records:
            row = records.get(Installation, 1)
    except (ServiceError, DBAPIError):
        return warn("cannot be compared with its database", "See the checks of the database.")
    stored = stored_id(blobs)
    if row is None or stored is None:
        return warn("names no installation yet", "The next start of a service writes it.")
    if stored != row.id:
        return failed(
            f"belongs to installation {stored}, the database to {row.id}",
            "Name the bucket and the database of one installation.",
        )
    return ok(f"and database belong to installation {stored}")


def check_images(settings: Settings, progress: Progress) -> Iterator[CheckResult]:
    """Read and hash every image that a row names, and count objects that no row names."""
    database = Database(settings.effective_database_url)
    try:
        blobs = open_blobs(settings, database)
        with database.read() as records:
            statement = sa.select(Measurement.sha256, Measurement.bytes).distinct()
            named = [(row.sha256, row.bytes) for row in records.execute(statement)]
        total, done, bad = sum(size for _, size in named), 0, list[str]()
        with ThreadPoolExecutor(_TOGETHER) as threads:
            for (sha256, size), whole in zip(
                named, threads.map(lambda original: blobs.is_whole(*original), named), strict=True
            ):
                done += size
                progress(done, total)
                if not whole and _is_named(database, sha256):  # else deleted meanwhile
                    bad.append(sha256)
        yield ok(f"{len(named)} images, {total / 1e6:.0f} MB read; {len(named) - len(bad)} are whole")
        for sha256 in bad[:_MAX_LISTED]:
            yield failed(f"{sha256} is missing or damaged", "Upload the image again: that puts it back.")
        if len(bad) > _MAX_LISTED:
            yield failed(f"and {len(bad) - _MAX_LISTED} more", "Restore the bucket's former versions.")
        hashes = {sha256 for sha256, _ in named}
        orphans = sum(sha256 not in hashes for found in blobs.names() for sha256, _ in found)
        if orphans:
            yield warn(
                f"{orphans} objects that no measurement names",
                "Nothing to do where they are few: a running service removes them a day after it found them.",
            )
    except ServiceError as error:
        yield failed(error.detail, error.advice or "")
    finally:
        database.dispose()


def _is_named(database: Database, sha256: str) -> bool:
    with database.read() as records:
        return bool(records.scalar(sa.select(sa.exists().where(Measurement.sha256 == sha256))))
