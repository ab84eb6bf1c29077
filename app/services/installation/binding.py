"""Database, data folder and pepper belong together: both places carry one installation id, the database identifies the
pepper, and nothing is opened where these disagree.

The id is made at the first start. `installation.json` is written first, as `making`; then the row is committed; then
the file says `made`. A crash in between is completed by the next start. An installation from before there were ids gets
one when it is first opened.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from datetime import UTC, datetime
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy import orm

from app.blobs.durable import write_once
from app.blobs.local import original_path
from app.errors import InstallationRefused
from app.logs import Logger
from app.records.activity import Activity, acting
from app.records.database import Database
from app.records.ids import new_id
from app.records.privacy import is_foreign
from app.records.tables import ApiKey, Installation, Measurement
from app.services.installation.identity import Identity, read_identity, write_identity
from app.settings import Settings

_ADVISORY_LOCK = 0x696E_7374  # "inst": first starts on one PostgreSQL database exclude one another
_SAMPLED_ORIGINS = 20
_BY_ADOPTION = "or start once with `gridpose serve --adopt`"
RESTORING = "restoring.json"
"""Lies in a data folder as long as a restore has not ended."""

log = Logger(__name__)


def sqlite_path(settings: Settings) -> Path | None:
    """Return the SQLite database's file; None for PostgreSQL."""
    url = sa.make_url(settings.effective_database_url)
    return Path(url.database or "") if url.get_backend_name() == "sqlite" else None


def require_installation(settings: Settings) -> None:
    """Raise InstallationRefused where the data folder holds no installation; make nothing."""
    data_dir = settings.data_dir
    refuse_half_restored(settings)
    identity = read_identity(data_dir)
    if settings.is_shared and _is_blank(identity):
        return  # one more machine: the database names the installation
    if identity is not None and identity.state == "made":
        return
    database = sqlite_path(settings)
    # Signs of an installation from before there were ids.
    signs = [data_dir / "key-pepper", data_dir / "originals"]
    if database is not None and database.parent == data_dir:
        signs = [database]
    if identity is None and any(sign.exists() for sign in signs):
        return
    raise InstallationRefused(
        "installation_missing",
        f"{data_dir} holds no installation.",
        "Check --data-dir and GRIDPOSE_DATA_DIR. `gridpose serve` makes a new installation; so does --init, where a "
        "command has it.",
    )


def refuse_half_restored(settings: Settings) -> None:
    """Raise InstallationRefused where a restore into the data folder did not end."""
    if (settings.data_dir / RESTORING).exists():
        raise InstallationRefused(
            "restore_incomplete",
            f"A restore into {settings.data_dir} was interrupted.",
            "Run `gridpose restore` with the same backup and data folder again.",
        )


def refuse_foreign_folder(settings: Settings) -> None:
    """Raise InstallationRefused where the data folder is something else's: it would be closed to its other users."""
    if is_foreign(settings.data_dir, sqlite_path(settings)):
        raise InstallationRefused(
            "folder_foreign",
            f"{settings.data_dir} holds other files and no installation.",
            "Name a new or an empty folder, or that of an installation, with --data-dir or GRIDPOSE_DATA_DIR.",
        )


def refuse_lost_database(settings: Settings, *, is_new: bool, adopt: bool) -> None:
    """Raise InstallationRefused where the folder is an installation's and the database is a new one."""
    identity = read_identity(settings.data_dir)
    if is_new and identity is not None and identity.state == "made" and not adopt:
        raise InstallationRefused(
            "installation_not_in_database",
            f"{settings.data_dir} belongs to installation {identity.id}, and the database is empty.",
            "Check GRIDPOSE_DATABASE_URL and --data-dir; or restore a backup into an empty folder "
            f"(`gridpose restore`); {_BY_ADOPTION} to begin again with an empty database.",
        )


def bind(settings: Settings, database: Database, *, adopt: bool, serves: bool = True) -> bytes:
    """Bring the ids of folder and database together where they are not yet, and return the pepper.

    Whoever does not serve needs none: a machine that only computes has no pepper, and this returns no bytes for it.

    With `adopt` a folder without an id takes the database's, and a new pepper is accepted: keys made with the former
    one are then revoked, and the audit trail says so. Raises InstallationRefused.
    """
    activity = Activity(actor="cli", action="adopt_installation", audited=False)
    with acting(activity), database.write() as records:
        if not database.is_sqlite:
            records.execute(sa.select(sa.func.pg_advisory_xact_lock(_ADVISORY_LOCK)))
        # The first statement takes SQLite's lock: the folder is read under it.
        row = records.get(Installation, 1)
        folder = read_identity(settings.data_dir)
        if row is None:
            if not adopt and settings.blob_url is None:
                refuse_foreign_originals(settings, records)
            if folder is None:
                folder = Identity(new_id("ins"), datetime.now(UTC), "making")
                write_identity(settings.data_dir, folder)
            row = Installation(id=folder.id, created_at=folder.created_at)
            records.add(row)
        elif (adopt or settings.is_shared) and _is_blank(folder):  # one more machine of the installation
            activity.audited = adopt and (folder is None or folder.id != row.id)
        else:
            require_same(settings, folder, row)
        pepper, revoked = b"", list[str]()
        if serves or not settings.is_shared:
            pepper, revoked = _settle_pepper(settings, records, row, adopt=adopt)
        activity.audited |= bool(revoked)
        activity.object_ids += [row.id, *revoked]
        identity = Identity(row.id, row.created_at)
    if folder != identity:
        write_identity(settings.data_dir, identity)
    return pepper


def require_same(settings: Settings, folder: Identity | None, row: Installation) -> None:
    """Raise InstallationRefused where folder and database are not of one installation."""
    if folder is not None and folder.id == row.id:
        return
    if _is_blank(folder):
        raise InstallationRefused(
            "installation_not_in_folder",
            f"The database belongs to installation {row.id}, and {settings.data_dir} holds none: its originals and "
            "its pepper lie in another folder.",
            "Name that folder with --data-dir or GRIDPOSE_DATA_DIR, or another database with GRIDPOSE_DATABASE_URL; "
            f"if the folder is lost, restore a backup (`gridpose restore`), {_BY_ADOPTION} to go on without it.",
        )
    assert folder is not None
    raise InstallationRefused(
        "installation_mismatch",
        f"{settings.data_dir} belongs to installation {folder.id}, the database to {row.id}.",
        "Name the folder and the database of one installation: --data-dir or GRIDPOSE_DATA_DIR, and "
        "GRIDPOSE_DATABASE_URL.",
    )


def refuse_foreign_originals(settings: Settings, records: orm.Session) -> None:
    """Raise InstallationRefused where a database without an id has images, and the folder has none of the newest."""
    newest = records.scalars(
        sa.select(Measurement.sha256).order_by(Measurement.id.desc()).limit(_SAMPLED_ORIGINS)
    ).all()
    root = settings.data_dir / "originals"
    if newest and not any(original_path(root, sha256).exists() for sha256 in newest):
        raise InstallationRefused(
            "originals_elsewhere",
            f"{settings.data_dir} has no original of the newest images of the database.",
            f"Name the data folder that belongs to this database, {_BY_ADOPTION} to go on without the originals.",
        )


def read_pepper(settings: Settings) -> bytes | None:
    """Return the secret that keys are hashed with, from the environment or the data folder; None for none."""
    if settings.key_pepper is not None:
        return settings.key_pepper.get_secret_value().encode()
    try:
        return pepper_path(settings.data_dir).read_bytes() or None
    except FileNotFoundError:
        return None


def pepper_path(data_dir: Path) -> Path:
    """Return where a data folder keeps its pepper."""
    return data_dir / "key-pepper"


def pepper_check(pepper: bytes) -> str:
    """Return what identifies a pepper and does not disclose it."""
    return hmac.new(pepper, b"gridpose key pepper", hashlib.sha256).hexdigest()


def require_pepper(settings: Settings, records: orm.Session, row: Installation | None) -> None:
    """Raise InstallationRefused where keys are in force that the pepper at hand, or a new one, would make useless."""
    pepper = read_pepper(settings)
    others_have_one = settings.is_shared and row is not None and row.pepper_check is not None
    if not others_have_one and not _keys_in_force(records):
        return
    if pepper is None:
        raise InstallationRefused(
            "pepper_missing",
            f"The database has API keys, and {settings.data_dir} lacks the pepper they are hashed with.",
            "Put the file key-pepper back from a backup, or set GRIDPOSE_KEY_PEPPER as it was; "
            f"{_BY_ADOPTION} to make a new one, which revokes all keys.",
        )
    if row is not None and row.pepper_check not in (
        None,
        pepper_check(pepper),
    ):  # of another machine, or lost
        raise InstallationRefused(
            "pepper_changed",
            "The pepper is not the one that the API keys in the database are hashed with.",
            "Set GRIDPOSE_KEY_PEPPER, or put the file key-pepper back, as it was; "
            f"{_BY_ADOPTION} to keep this pepper, which revokes all keys.",
        )


def revoke_all_keys(records: orm.Session) -> list[str]:
    """Revoke every key that is not yet, and return their ids."""
    revoked = records.scalars(
        sa.update(ApiKey)
        .where(ApiKey.revoked_at.is_(None))
        .values(revoked_at=datetime.now(UTC))
        .returning(ApiKey.id)
    )
    return sorted(revoked)


def _settle_pepper(
    settings: Settings, records: orm.Session, row: Installation, *, adopt: bool
) -> tuple[bytes, list[str]]:
    """Return the pepper and the ids of the keys that were revoked because it is a new one."""
    if not adopt:
        require_pepper(settings, records, row)
    pepper = read_pepper(settings)
    is_former = pepper is not None and row.pepper_check in (None, pepper_check(pepper))
    if pepper is None:
        # An empty file is no pepper, and prevents making one.
        path = pepper_path(settings.data_dir)
        if path.exists() and path.stat().st_size == 0:
            path.unlink()
        write_once(path, secrets.token_hex(32).encode())
        pepper = path.read_bytes()
    revoked = [] if is_former else revoke_all_keys(records)
    if revoked:
        log.warning("keys_revoked", reason="new pepper", keys=len(revoked))
    row.pepper_check = pepper_check(pepper)
    return pepper, revoked


def _keys_in_force(records: orm.Session) -> bool:
    return records.scalar(sa.select(ApiKey.id).where(ApiKey.revoked_at.is_(None)).limit(1)) is not None


def _is_blank(folder: Identity | None) -> bool:
    return folder is None or folder.state == "making"
