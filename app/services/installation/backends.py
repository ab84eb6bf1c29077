"""What an installation of several machines is built on, its PostgreSQL server and its bucket: refused at start where
they would lose images or times, rather than found out later.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import sqlalchemy as sa

from app.blobs import S3Blobs
from app.blobs.durable import write_durably
from app.errors import InstallationRefused, Unavailable
from app.records.database import Database
from app.records.tables import Installation, Measurement
from app.settings import Settings

if TYPE_CHECKING:
    import psycopg

MAX_SKEW = timedelta(seconds=60)
"""Largest difference between this machine's clock and the server's: ids and times order what several machines write."""
DOCUMENT = "installation.json"
MOVED = "moved.json"
"""Lies in a data folder whose installation was moved, and says where to."""


def clock_skew(database: Database) -> timedelta:
    """Return how far this machine's clock is ahead of the PostgreSQL server's."""
    before = datetime.now(UTC)
    with database.read() as records:
        server: datetime = records.scalar(sa.select(sa.func.clock_timestamp())) or before
    after = datetime.now(UTC)
    return before + (after - before) / 2 - server


def require_clock(database: Database) -> None:
    """Raise InstallationRefused where this machine's clock is not the PostgreSQL server's."""
    skew = clock_skew(database)
    if abs(skew) > MAX_SKEW:
        side = "ahead of" if skew > timedelta(0) else "behind"
        raise InstallationRefused(
            "clock_skewed",
            f"This machine's clock is {abs(skew.total_seconds()):.0f} s {side} the database server's.",
            "Set both clocks, best by NTP: images of several machines are ordered by time.",
        )


def is_pooled(database: Database) -> bool:
    """Return whether a pooler hands the transactions of one connection to several of the server's.

    Such a pooler delivers no notifications and keeps no locks between transactions.
    """
    import psycopg  # an extra

    options = database.driver_options()
    with (
        psycopg.connect(**options, autocommit=True, prepare_threshold=None) as one,
        psycopg.connect(**options, autocommit=True, prepare_threshold=None) as other,
    ):
        first = _backend(one)
        if first == one.info.backend_pid:
            return False  # connected to the server itself
        with other.transaction():  # takes the server's connection that was free last
            return _backend(other) == first or _backend(one) != first


def _backend(connection: psycopg.Connection) -> int:
    row = connection.execute("SELECT pg_backend_pid()").fetchone()
    assert row is not None
    return int(row[0])


def require_direct(database: Database) -> None:
    """Raise InstallationRefused where a pooler in transaction mode stands between this process and the server."""
    if is_pooled(database):
        raise InstallationRefused(
            "database_pooled",
            "GRIDPOSE_DATABASE_URL leads to a pooler in transaction mode, which delivers no notifications.",
            "Name the PostgreSQL server itself, or a pool in session mode.",
        )


def require_bucket(blobs: S3Blobs, url: str) -> None:
    """Raise InstallationRefused where the bucket cannot be written, or does not keep what was written first."""
    try:
        keeps_first = blobs.probe()
    except FileNotFoundError as error:
        raise InstallationRefused(
            "bucket_missing",
            f"There is no bucket of {url}.",
            "Create it, or check GRIDPOSE_BLOB_URL and AWS_ENDPOINT_URL.",
        ) from error
    except Unavailable as error:
        if error.code == "storage_refused":
            raise InstallationRefused(
                "bucket_refused",
                f"{url} cannot be written and read with these credentials.",
                "Check AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, this machine's clock, and that the bucket's policy "
                "allows GetObject, PutObject, DeleteObject and ListBucket.",
            ) from error
        raise InstallationRefused(
            "bucket_unreachable",
            f"The object store of {url} does not answer.",
            "Check GRIDPOSE_BLOB_URL, AWS_ENDPOINT_URL and the network between.",
        ) from error
    if not keeps_first:
        raise InstallationRefused(
            "bucket_not_conditional",
            f"The object store of {url} replaces an object that was to be created only.",
            "Use a store that honours If-None-Match on PUT, such as AWS S3, MinIO, SeaweedFS or Ceph of this year.",
        )


def bind_bucket(blobs: S3Blobs, url: str, database: Database, *, adopt: bool) -> None:
    """Give the bucket the installation's id, or raise InstallationRefused where it is another's or lost its images."""
    with database.read() as records:
        row = records.get_one(Installation, 1)
        has_images = records.scalar(sa.select(sa.exists().where(Measurement.id.is_not(None))))
    stored = stored_id(blobs)
    if stored is None:
        if has_images and not adopt:
            raise InstallationRefused(
                "originals_elsewhere",
                f"{url} holds no installation, and the database has images.",
                "Check GRIDPOSE_BLOB_URL. `gridpose migrate-to` copies the images of a data folder; "
                "`gridpose serve --adopt` goes on without them.",
            )
        write_id(blobs, row.id)
        stored = stored_id(blobs)
    if stored != row.id:
        raise InstallationRefused(
            "installation_mismatch",
            f"{url} belongs to installation {stored}, the database to {row.id}.",
            "Name the bucket and the database of one installation: GRIDPOSE_BLOB_URL and GRIDPOSE_DATABASE_URL.",
        )


def stored_id(blobs: S3Blobs) -> str | None:
    """Return the id of the installation whose images a bucket holds; None where it does not say."""
    content = blobs.read_document(DOCUMENT)
    if content is None:
        return None
    try:
        return str(json.loads(content)["id"])
    except (ValueError, KeyError, TypeError):
        return "that cannot be read"


def write_id(blobs: S3Blobs, installation_id: str) -> None:
    """Name the installation in a bucket that names none; the first of several processes wins."""
    blobs.create_document(DOCUMENT, (json.dumps({"id": installation_id}) + "\n").encode())


def mark_moved(settings: Settings, target: Settings) -> None:
    """Note in the data folder that database or images are elsewhere from now on."""
    document = {"database": _shown(target), "images": target.blob_url}
    write_durably(settings.data_dir / MOVED, (json.dumps(document, indent=1) + "\n").encode())


def refuse_moved(settings: Settings) -> None:
    """Raise InstallationRefused where the installation was moved and the settings name its former place."""
    try:
        moved = json.loads((settings.data_dir / MOVED).read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return
    if (_shown(settings), settings.blob_url) != (moved.get("database"), moved.get("images")):
        raise InstallationRefused(
            "installation_moved",
            f"The installation of {settings.data_dir} was moved: database {moved.get('database')}, images "
            f"{moved.get('images') or 'in the data folder'}.",
            f"Set GRIDPOSE_DATABASE_URL and GRIDPOSE_BLOB_URL so. To go back without what came since, remove {MOVED}.",
        )


def _shown(settings: Settings) -> str:
    return sa.make_url(settings.effective_database_url).render_as_string()
