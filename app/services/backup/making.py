"""A backup of a running installation: the database's rows at one moment, then the originals they name.

An original is written before its row and never changes, so that every original of that moment is there afterwards,
unless it was deleted meanwhile; then another moment is taken. What an earlier backup in the folder holds is not copied
again. The earlier backup stays whole until the manifest of the new one takes its place.
"""

from __future__ import annotations

import hashlib
import shutil
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import sqlalchemy as sa

from app.blobs import LocalBlobs
from app.blobs.durable import sync_folder, write_durably
from app.blobs.local import original_path
from app.build import core_version
from app.errors import BackupRefused, OriginalCorrupt, OriginalMissing, ServiceError, StorageFull
from app.records import migrations
from app.records.database import Database
from app.records.file_lock import AlreadyLocked, FileLock
from app.records.rows import count_rows
from app.records.tables import Installation as InstallationRow
from app.records.tables import Measurement
from app.services.backup.damage import damage_advice, noted_backup
from app.services.backup.latest import note_backup
from app.services.backup.manifest import (
    FORMAT,
    LEFT_BY_OTHERS,
    Manifest,
    claim_folder,
    copy_verified,
    file_sha256,
    pepper_name,
    write_manifest,
)
from app.services.backup.succession import require_succession
from app.services.installation.context import ServiceContext
from app.services.installation.outputs import output_failures

_MOMENTS = 3
"""Moments tried before originals that were deleted during the backup are given up."""


@dataclass(frozen=True, slots=True)
class Report:
    """A backup just completed, and how much of it was copied this time."""

    manifest: Manifest
    copied: int
    copied_bytes: int


def make_backup(installation: ServiceContext, folder: Path, *, replace_newer: bool = False) -> Report:
    """Bring `folder` up to the present moment of the installation, while it is used.

    Raises BackupRefused where the folder is not for this, in use, cannot be used or has too little room, where its
    backup holds what the installation lacks (unless `replace_newer`), and where the database is damaged.
    """
    data_dir = installation.settings.data_dir
    _refuse_data_folder(data_dir, folder)
    try:
        with output_failures(data_dir, partial(_unusable, folder)):
            return _made(installation, folder, replace_newer=replace_newer)
    except ServiceError as error:
        if error.code != "database_damaged":
            raise
        latest = noted_backup(data_dir)
        kept = "" if latest is None else f" The backup of {latest.created_at:%Y-%m-%d %H:%M} UTC is kept."
        raise BackupRefused(
            "database_damaged",
            f"The database is damaged, and no backup was made.{kept}",
            damage_advice(installation.settings),
        ) from error


def _made(installation: ServiceContext, folder: Path, *, replace_newer: bool) -> Report:
    with installation.database.read() as records:
        row = records.get_one(InstallationRow, 1)
    claim_folder(folder, row.id)
    lock = FileLock(folder / "backup.lock")
    try:
        lock.acquire()
    except AlreadyLocked as error:
        raise BackupRefused(
            "backup_folder_in_use", f"Another backup to {folder} is being made.", "Wait for its end."
        ) from error
    try:
        if not replace_newer:
            require_succession(installation.database, folder)
        report = _Making(installation, row.id, folder).run()
        note_backup(installation.settings.data_dir, report.manifest, folder)
        return report
    finally:
        lock.release()


def _refuse_data_folder(data_dir: Path, folder: Path) -> None:
    """Raise BackupRefused where the backup would lie in what it is a backup of."""
    if folder.resolve().is_relative_to(data_dir.resolve()):
        raise BackupRefused(
            "backup_in_data_folder",
            f"{folder} lies in the data folder {data_dir}, and would be lost with it.",
            "Name a folder on another disk.",
        )


def _unusable(folder: Path, named: Path | None, reason: str) -> BackupRefused:
    return BackupRefused(
        "backup_folder_unusable",
        f"The backup folder {folder} cannot be used. {named or folder}: {reason}.",
        "Allow this user to read and write it, check that its disk is mounted, writable and has room, or name "
        "another folder.",
    )


def _copy_database(database: Database, path: Path) -> None:
    """Copy the rows of this moment. Raises BackupRefused where the copy has no room; its source takes none."""
    try:
        migrations.copy_to_file(database, path)
    except (StorageFull, migrations.NoRoomForCopy) as error:
        raise BackupRefused(
            "no_room",
            f"The copy of the database takes {database.size_bytes()} bytes, and the disk of {path.parent} was full or "
            f"refused them ({shutil.disk_usage(path.parent).free} are free now).",
            "Free space there, or name a folder on a larger disk. The earlier backup is kept.",
        ) from error


class _Making:
    def __init__(self, installation: ServiceContext, installation_id: str, folder: Path) -> None:
        self._installation = installation
        self._id = installation_id
        self._folder = folder
        self._originals = folder / "originals"
        self._originals.mkdir(exist_ok=True, mode=0o700)
        self._copied = self._copied_bytes = 0

    def run(self) -> Report:
        with self._installation.database.read() as records:
            self._require_room(_named_originals(records.connection()))
        for moment in range(1, _MOMENTS + 1):
            created_at = datetime.now(UTC)
            path = self._folder / f"database-{created_at:%Y%m%dT%H%M%S.%fZ}.sqlite3"
            _copy_database(self._installation.database, path)
            copy = Database(sa.URL.create("sqlite", database=str(path)))
            try:
                with copy.read() as records:
                    named = _named_originals(records.connection())
                    rows = count_rows(records.connection())
                revision = migrations.current_revision(copy)
            finally:
                copy.dispose()
            missing, corrupt = self._copy_originals(named)
            if moment == _MOMENTS or not self._deleted_meanwhile(missing):
                break
            path.unlink()
        assert revision is not None, "the installation's schema is this program's"
        pepper = self._installation.pepper
        pepper_sha256 = hashlib.sha256(pepper).hexdigest()
        write_durably(self._folder / pepper_name(pepper_sha256), pepper)
        manifest = Manifest(
            format=FORMAT,
            installation_id=self._id,
            created_at=created_at.isoformat(),
            core_version=core_version(),
            revision=revision,
            source=self._installation.database.url.get_backend_name(),
            database=path.name,
            database_sha256=file_sha256(path),
            database_bytes=path.stat().st_size,
            pepper=pepper_name(pepper_sha256),
            pepper_sha256=pepper_sha256,
            rows=rows,
            originals=len(named) - len(missing) - len(corrupt),
            original_bytes=sum(size for sha256, size in named.items() if sha256 not in {*missing, *corrupt}),
            missing=missing,
            corrupt=corrupt,
        )
        write_manifest(self._folder, manifest)
        self._remove_all_but(manifest, set(named))
        return Report(manifest, self._copied, self._copied_bytes)

    def _copy_originals(self, named: dict[str, int]) -> tuple[list[str], list[str]]:
        """Copy what the backup lacks; return which originals are missing and which have other bytes."""
        missing, corrupt, touched = [], [], set()
        for sha256, size in named.items():
            target = original_path(self._originals, sha256)
            if target.exists() and target.stat().st_size == size:
                continue
            target.parent.mkdir(exist_ok=True, mode=0o700)
            try:
                whole = self._copy(sha256, size, target)
            except FileNotFoundError:
                missing.append(sha256)
                continue
            if not whole:
                corrupt.append(sha256)
                continue
            touched.add(target.parent)
            self._copied += 1
            self._copied_bytes += size
        for folder in touched:
            sync_folder(folder)
        sync_folder(self._originals)
        return missing, corrupt

    def _copy(self, sha256: str, size: int, target: Path) -> bool:
        """Copy an original durably; return whether its bytes were right. Raises FileNotFoundError."""
        blobs = self._installation.blobs
        if isinstance(blobs, LocalBlobs):
            return copy_verified(blobs.path(sha256), target, sha256)
        try:
            with blobs.open(sha256, size) as original:
                write_durably(target, original.read())
        except OriginalMissing as error:
            raise FileNotFoundError from error
        except OriginalCorrupt:
            return False
        return True

    def _deleted_meanwhile(self, missing: list[str]) -> bool:
        """Return whether an original is missing because its rows have gone since the moment of the copy."""
        with self._installation.database.read() as records:
            return any(
                records.scalar(sa.select(Measurement.id).where(Measurement.sha256 == sha256).limit(1)) is None
                for sha256 in missing
            )

    def _require_room(self, named: dict[str, int]) -> None:
        lacking = sum(
            size for sha256, size in named.items() if not original_path(self._originals, sha256).exists()
        )
        needed = lacking + self._installation.database.size_bytes()
        free = shutil.disk_usage(self._folder).free
        if free < needed:
            raise BackupRefused(
                "no_room",
                f"The backup takes {needed} bytes more, and {free} are free in {self._folder}.",
                "Free space there, or name a folder on a larger disk.",
            )

    def _remove_all_but(self, manifest: Manifest, named: set[str]) -> None:
        """Remove what only an earlier backup, or an interrupted one, consisted of."""
        for path in (path for pattern in LEFT_BY_OTHERS for path in self._folder.glob(pattern)):
            if path.name not in (manifest.database, manifest.pepper):
                path.unlink(missing_ok=True)
        for path in self._originals.glob("*/*"):
            if path.name not in named:
                path.unlink(missing_ok=True)


def _named_originals(connection: sa.Connection) -> dict[str, int]:
    """Return the size of every original that a row names, by its hash."""
    statement = sa.select(Measurement.sha256, Measurement.bytes).distinct().order_by(Measurement.sha256)
    return {row.sha256: row.bytes for row in connection.execute(statement)}
