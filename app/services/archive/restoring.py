"""A session from its archive, in an installation that may be in use.

The file is read once. Rows go to a database of their own, at the archive's schema, which migrations bring to this
version's; originals go to files alongside. Only when every hash, every signature and every row is found right do they
take their places: originals first, then all rows in one transaction.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from app.blobs import LocalBlobs
from app.blobs.durable import sync_folder
from app.blobs.local import original_path
from app.errors import ArchiveRefused
from app.records.activity import Activity, acting
from app.records.database import Database
from app.records.file_lock import FileLock
from app.services.archive.container import PIECE, ArchiveReader
from app.services.archive.copying import put_rows, require_absent
from app.services.archive.manifest import (
    MANIFEST_NAME,
    MAX_SMALL_BYTES,
    README_NAME,
    SIGNATURE_NAME,
    ArchivedFile,
    ArchiveManifest,
    decode_manifest,
)
from app.services.archive.staging import StagedRows
from app.services.installation.context import ServiceContext
from app.services.maintenance.unfinished import (
    FOLDERS_LOCK,
    RESTORING_LOCK,
    RESTORING_SESSION,
    remove_left_folders,
)
from app.services.originals import remove_unreferenced

_MARGIN = 2.0
"""The rows' bytes are there as lines, and twice in the database that is migrated."""


@dataclass(frozen=True, slots=True)
class Restored:
    """A session just restored: its archive's manifest, who signed it, and which rows were there already."""

    manifest: ArchiveManifest
    fingerprint: str
    already_there: dict[str, int]


def restore_session(installation: ServiceContext, path: Path, *, trusted: str | None = None) -> Restored:
    """Store the session of an archive, with the ids it had, byte for byte what it was.

    `trusted` is the fingerprint of the only key whose archives are taken. Raises ArchiveRefused; then nothing is
    stored.
    """
    with ArchiveReader(path) as reader:
        reader.read(README_NAME, MAX_SMALL_BYTES)
        content = reader.read(MANIFEST_NAME, MAX_SMALL_BYTES)
        manifest, fingerprint = decode_manifest(content, reader.read(SIGNATURE_NAME, MAX_SMALL_BYTES))
        if trusted is not None and trusted.strip().lower() != fingerprint:
            raise ArchiveRefused(
                "archive_foreign",
                f"The archive was signed by another key, {fingerprint}.",
                "Ask the installation that made it for its key: `signing_key` of one of its reports.",
            )
        _require_room(installation, manifest)
        require_absent(installation.database, manifest.session_id)
        with _staging(installation.settings.data_dir) as folder:
            rows = StagedRows(folder, manifest)
            try:
                _read_members(reader, manifest, rows, folder)
                rows.complete()
                already_there = _take_over(installation, manifest, rows.database, folder)
            finally:
                rows.close()
    return Restored(manifest, fingerprint, already_there)


@contextmanager
def _staging(data_dir: Path) -> Iterator[Path]:
    """Give a folder for what is not examined yet, and remove those that restores left which were killed."""
    folder = data_dir / f"{RESTORING_SESSION}{secrets.token_hex(8)}"
    lock = FileLock(folder / RESTORING_LOCK)
    # A folder whose lock is not taken yet looks like one that was left.
    with FileLock(data_dir / FOLDERS_LOCK):
        remove_left_folders(data_dir)
        folder.mkdir(mode=0o700)
        lock.acquire()
    try:
        yield folder
    finally:
        lock.release()
        shutil.rmtree(folder, ignore_errors=True)


def _read_members(reader: ArchiveReader, manifest: ArchiveManifest, rows: StagedRows, folder: Path) -> None:
    for file in manifest.files:
        if file.table is not None:
            taker = rows.lines(file.table)
            reader.copy(file.name, file.bytes, file.sha256, taker.take)
            taker.end()
        elif file.original is not None:
            with (folder / file.sha256).open("xb") as original:
                reader.copy(file.name, file.bytes, file.sha256, original.write)
        else:
            pieces: list[bytes] = []
            reader.copy(file.name, file.bytes, file.sha256, pieces.append)
            rows.take_form(file, b"".join(pieces))
    reader.require_end()


def _take_over(
    installation: ServiceContext, manifest: ArchiveManifest, rows: Database, folder: Path
) -> dict[str, int]:
    """Put originals and rows into their places; return how many rows of each table were there already."""
    published: list[str] = []
    try:
        for file in manifest.originals:
            if not installation.blobs.is_whole(file.sha256, file.bytes):
                published.append(file.sha256)
                _publish(installation, folder / file.sha256, file)
        activity = Activity(actor="cli", action="restore_session", object_ids=[manifest.session_id])
        with acting(activity), rows.read() as given, installation.database.write() as taken:
            if not installation.database.is_sqlite:
                # The lock of migration 0027 holds up who follows a session, until all rows are there: nobody follows
                # a session that is not there yet.
                taken.execute(sa.text("SELECT set_config('gridpose.numbers_changes', 'yes', true)"))
            already_there = put_rows(given, taken)
    except BaseException:
        with suppress(Exception):  # what is left without a row, the sweep removes
            remove_unreferenced(installation.database, installation.blobs, published)
        raise
    # A deletion of the same originals, recorded before, may have been finished in between.
    for file in manifest.originals:
        if not installation.blobs.is_there(file.sha256):
            _publish(installation, folder / file.sha256, file)
    return already_there


def _publish(installation: ServiceContext, staged: Path, file: ArchivedFile) -> None:
    """Put an original under its name, durably. The service empties the folder of uploads, so it is not used here."""
    blobs = installation.blobs
    if isinstance(blobs, LocalBlobs):
        target = original_path(blobs.root, file.sha256)
        target.parent.mkdir(exist_ok=True)
        copy = target.with_name(f"{target.name}.{secrets.token_hex(8)}")
        try:
            shutil.copyfile(staged, copy)
            with copy.open("rb+") as copied:
                os.fsync(copied.fileno())
            copy.chmod(0o600)
            copy.replace(target)
        finally:
            copy.unlink(missing_ok=True)
        sync_folder(target.parent)
        return
    upload = blobs.stage()
    try:
        with staged.open("rb") as original:
            while piece := original.read(PIECE):
                upload.write(piece)
        with blobs.lock(file.sha256):
            blobs.publish(upload)
    finally:
        upload.discard()


def _require_room(installation: ServiceContext, manifest: ArchiveManifest) -> None:
    rows = sum(file.bytes for file in manifest.files if file.original is None)
    originals = sum(file.bytes for file in manifest.originals)
    needed = int(_MARGIN * rows) + 2 * originals
    free = shutil.disk_usage(installation.settings.data_dir).free
    if free - needed < installation.settings.disk_floor_bytes:
        raise ArchiveRefused(
            "no_room",
            f"The session takes {needed} bytes while it is restored, and {free} are free in "
            f"{installation.settings.data_dir}.",
            "Free space there first.",
        )
