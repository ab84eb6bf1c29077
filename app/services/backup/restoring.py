"""An installation from a backup, in an empty data folder and an empty database.

`restoring.json` lies in the folder from the first moment to the last: with it nothing else opens the folder, and a
restore of the same backup takes up where the last one was interrupted.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy import orm

from app.blobs.durable import sync_folder, write_durably
from app.blobs.local import original_path
from app.errors import BackupRefused
from app.records import migrations
from app.records.activity import Activity, acting
from app.records.database import Database
from app.records.file_lock import AlreadyLocked, FileLock
from app.records.presence import RunnerLock
from app.records.privacy import OF_THE_FILE_SYSTEM
from app.records.rows import copy_rows, count_rows
from app.records.tables import Installation, Measurement
from app.services.backup.manifest import Manifest, copy_verified, file_sha256, read_manifest
from app.services.installation.binding import (
    RESTORING,
    pepper_check,
    pepper_path,
    revoke_all_keys,
    sqlite_path,
)
from app.services.installation.identity import Identity, write_identity
from app.services.notices import delete_all_webhooks
from app.settings import Settings

_NO_CONTENT = OF_THE_FILE_SYSTEM | {"head.lock", "runner.lock", "migrate.lock"}
_UNFINISHED = (
    "restoring.sqlite3*",
    "originals/*/*.partial",
    f"{RESTORING}.*",
    "key-pepper.*",
    "installation.json.*",
)
_SHOWN = 10


def restore_backup(
    folder: Path,
    settings: Settings,
    *,
    accept_damage: bool = False,
    revoke_keys: bool = False,
    delete_webhooks: bool = False,
) -> tuple[Manifest, list[str]]:
    """Make the data folder and the database of `settings` what they were at the moment of the backup in `folder`.

    Every file is verified against its hash. With `revoke_keys` no key of that moment is valid, with `delete_webhooks`
    nobody is sent anything. Return the backup's manifest and the hashes of damaged originals, an empty list without
    `accept_damage`. Raises BackupRefused.
    """
    changes = {"revoke_keys": revoke_all_keys} if revoke_keys else {}
    changes |= {"delete_webhooks": delete_all_webhooks} if delete_webhooks else {}
    manifest = read_manifest(folder)
    if manifest is None:
        raise BackupRefused(
            "backup_incomplete",
            f"{folder} holds no complete backup.",
            "Name the folder that `gridpose backup` was given; if that was interrupted, run it again.",
        )
    settings.data_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
    database = None
    if sqlite_path(settings) is None:
        database = Database(settings.effective_database_url)
    try:
        with _alone(settings, database):
            _require_empty(settings, database, manifest)
            _remove_unfinished(settings.data_dir)
            _require_room(settings, manifest)
            damaged = _restore(folder, settings, database, manifest, changes, accept_damage=accept_damage)
            return manifest, damaged
    finally:
        if database is not None:
            database.dispose()


def _restore(
    folder: Path,
    settings: Settings,
    database: Database | None,
    manifest: Manifest,
    changes: Mapping[str, Callable[[orm.Session], list[str]]],
    *,
    accept_damage: bool,
) -> list[str]:
    data_dir = settings.data_dir
    marker = {"installation_id": manifest.installation_id, "database_sha256": manifest.database_sha256}
    write_durably(data_dir / RESTORING, json.dumps(marker).encode())
    pepper = _verified_pepper(folder, manifest)
    path = data_dir / "restoring.sqlite3"
    if not copy_verified(folder / manifest.database, path, manifest.database_sha256):
        raise _damaged(f"its database {manifest.database} has other bytes than it was made with")
    copy = Database(sa.URL.create("sqlite", database=str(path)))
    try:
        migrations.upgrade(copy, data_dir, copy_first=False)
        with copy.read() as records:
            row = records.get_one(Installation, 1)
            _require_stated_pepper(settings, row)
            named = records.execute(
                sa.select(Measurement.sha256, Measurement.bytes).distinct().order_by(Measurement.sha256)
            ).all()
        unknown = {*manifest.missing, *manifest.corrupt}
        damaged = _copy_originals(folder, data_dir, [(s, size) for s, size in named if s not in unknown])
        if damaged and not accept_damage:
            shown = ", ".join(damaged[:_SHOWN]) + (", ..." if len(damaged) > _SHOWN else "")
            raise _damaged(
                f"{len(damaged)} originals are missing or have other bytes: {shown}",
                "Use another backup; or restore what is whole with --accept-damage.",
            )
        if database is not None:
            _fill(database, copy, data_dir)
        for action, change in changes.items():
            _change(database or copy, action, change)
    finally:
        copy.dispose()
    target = sqlite_path(settings)
    if target is None:
        path.unlink()
    else:
        for suffix in ("-wal", "-shm"):
            target.with_name(target.name + suffix).unlink(missing_ok=True)
        path.chmod(0o600)
        with path.open("rb+") as file:
            os.fsync(file.fileno())
        shutil.move(path, target)
        sync_folder(target.parent)
    write_durably(pepper_path(data_dir), pepper)
    write_identity(data_dir, Identity(row.id, row.created_at))
    (data_dir / RESTORING).unlink()
    sync_folder(data_dir)
    return damaged


def _fill(database: Database, copy: Database, data_dir: Path) -> None:
    """Put the rows of the copy into an empty PostgreSQL database, all or none."""
    migrations.upgrade(database, data_dir, copy_first=False)
    with copy.read() as records, database.engine.begin() as target:
        if not any(count_rows(target).values()):  # an interrupted restore may have come so far
            copy_rows(records.connection(), target)


def _change(database: Database, action: str, change: Callable[[orm.Session], list[str]]) -> None:
    activity = Activity(actor="cli", action=action)
    with acting(activity), database.write() as records:
        activity.object_ids += change(records)
        activity.audited = bool(activity.object_ids)


def _copy_originals(folder: Path, data_dir: Path, named: list[tuple[str, int]]) -> list[str]:
    """Copy and verify the originals; return the hashes of those that the backup does not have whole."""
    damaged, touched = [], set()
    root = data_dir / "originals"
    root.mkdir(exist_ok=True, mode=0o700)
    for sha256, size in named:
        target = original_path(root, sha256)
        if target.exists() and target.stat().st_size == size and file_sha256(target) == sha256:
            continue
        target.parent.mkdir(exist_ok=True)
        touched.add(target.parent)
        try:
            whole = copy_verified(original_path(folder / "originals", sha256), target, sha256)
        except FileNotFoundError:
            whole = False
        if not whole:
            damaged.append(sha256)
    for each in (*touched, root):
        sync_folder(each)
    return damaged


def _verified_pepper(folder: Path, manifest: Manifest) -> bytes:
    try:
        pepper = (folder / manifest.pepper).read_bytes()
    except FileNotFoundError:
        pepper = b""
    if hashlib.sha256(pepper).hexdigest() != manifest.pepper_sha256:
        raise _damaged(f"its {manifest.pepper} is missing or has other bytes than it was made with")
    return pepper


def _require_stated_pepper(settings: Settings, row: Installation) -> None:
    if settings.key_pepper is None or row.pepper_check is None:
        return
    if pepper_check(settings.key_pepper.get_secret_value().encode()) != row.pepper_check:
        raise BackupRefused(
            "pepper_changed",
            "GRIDPOSE_KEY_PEPPER is not the pepper that the backup's keys are hashed with.",
            "Unset it, to use the pepper in the backup, or set it as it was.",
        )


def _require_empty(settings: Settings, database: Database | None, manifest: Manifest) -> None:
    """Raise BackupRefused unless folder and database are empty, or were being filled from this very backup."""
    resumed = _is_resumed(settings.data_dir, manifest)
    found = sorted(
        path.name
        for path in settings.data_dir.iterdir()
        if path.name not in _NO_CONTENT and not path.name.startswith(f"{RESTORING}.")
    )
    if found and not resumed:
        raise _not_empty(
            f"{settings.data_dir} is not empty: {', '.join(found[:_SHOWN])}.",
            "Name a new or an empty folder with --data-dir.",
        )
    file = sqlite_path(settings)
    if file is not None and file.exists() and not resumed:
        raise _not_empty(f"The database {file} is there already.", "Move it away, or name another.")
    if database is None:
        return
    with database.engine.connect() as connection:
        rows = {name: count for name, count in count_rows(connection).items() if count}
        own = None
        if resumed and "installation" in rows:
            own = connection.scalar(sa.select(Installation.id))
    if rows and own != manifest.installation_id:
        raise _not_empty(
            f"The database is not empty: {', '.join(sorted(rows)[:_SHOWN])} have rows.",
            "Name an empty database with GRIDPOSE_DATABASE_URL.",
        )


def _is_resumed(data_dir: Path, manifest: Manifest) -> bool:
    try:
        marker = json.loads((data_dir / RESTORING).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return False
    if marker.get("database_sha256") != manifest.database_sha256:
        raise _not_empty(
            f"A restore of another backup into {data_dir} was interrupted.",
            "Restore that one again, or empty the folder.",
        )
    return True


def _remove_unfinished(data_dir: Path) -> None:
    """Remove what an interrupted restore had not ended: it is made anew."""
    for pattern in _UNFINISHED:
        for path in data_dir.glob(pattern):
            path.unlink(missing_ok=True)


def _require_room(settings: Settings, manifest: Manifest) -> None:
    in_place = sum(path.stat().st_size for path in (settings.data_dir / "originals").glob("*/*"))
    # Twice the database: it may be migrated.
    needed = max(0, manifest.original_bytes - in_place) + 2 * manifest.database_bytes
    free = shutil.disk_usage(settings.data_dir).free
    if free < needed:
        raise BackupRefused(
            "no_room",
            f"The restored data take {needed} bytes, and {free} are free in {settings.data_dir}.",
            "Name a folder on a larger disk with --data-dir.",
        )


@contextmanager
def _alone(settings: Settings, database: Database | None) -> Iterator[None]:
    """Keep services and workers from the data folder, and from a PostgreSQL database."""
    head = FileLock(settings.data_dir / "head.lock")
    try:
        head.acquire()
        lock: FileLock | RunnerLock = FileLock(settings.data_dir / "runner.lock")
        if database is not None:
            lock = RunnerLock(settings.data_dir, database, alone=True)
        lock.acquire()
    except AlreadyLocked as error:
        head.release()
        raise BackupRefused(
            "service_running",
            f"A service or a worker uses {settings.data_dir} or its database.",
            "End it first, or name another data folder and database.",
        ) from error
    try:
        yield
    finally:
        lock.release()
        head.release()


def _damaged(what: str, advice: str = "Use another backup.") -> BackupRefused:
    return BackupRefused("backup_damaged", f"The backup is damaged: {what}.", advice)


def _not_empty(what: str, advice: str) -> BackupRefused:
    return BackupRefused("restore_not_empty", what, advice)
