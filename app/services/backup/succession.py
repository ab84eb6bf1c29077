"""Whether an installation may replace the backup in a folder: it is the one that was backed up, grown since.

A copy of an installation, such as one restored for a drill, has the same id. The audit trail sets them apart: every
change by a person or a program appends an entry, and no privacy deletion and no retention removes one. An installation
that lacks the newest entry of the backup lacks what was changed with it.
"""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import sqlalchemy as sa

from app.errors import BackupRefused
from app.records.database import Database, is_damage, sqlite_driver
from app.records.tables import AuditEntry
from app.services.backup.manifest import read_manifest


def require_succession(database: Database, folder: Path) -> None:
    """Raise BackupRefused where the folder's complete backup holds what the database lacks, or is not known.

    A damaged backup protects nothing and may be replaced.
    """
    try:
        manifest = read_manifest(folder)
    except BackupRefused as error:
        if error.code != "backup_damaged":
            raise
        return
    newest = None if manifest is None else _newest_entry(folder / manifest.database)
    if manifest is None or newest is None:
        return
    with database.read() as records:
        if records.scalar(sa.select(AuditEntry.id).where(AuditEntry.id == newest)) is not None:
            return
    raise BackupRefused(
        "backup_newer",
        f"{folder} holds a backup of this installation, as of {manifest.created_at}, with changes that the database "
        "lacks: this is an earlier state, or a copy that went another way.",
        "Name another folder. Only where this installation has taken the place of the one that was backed up, and the "
        "later state may be lost: --replace-newer.",
    )


def _newest_entry(path: Path) -> str | None:
    """Return the newest audit entry of a backup's database; None where it has none, is damaged or is gone."""
    driver, _ = sqlite_driver()
    if not path.is_file():
        return None
    try:
        # Immutable: without it, SQLite may leave files alongside, and asks for locks that a network disk lacks.
        with closing(driver.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)) as connection:
            (newest,) = connection.execute("SELECT max(id) FROM audit_entries").fetchone()
            return None if newest is None else str(newest)
    except driver.DatabaseError as error:
        if is_damage(error) or "no such table" in str(error):
            return None
        raise OSError(None, f"the earlier backup cannot be read: {error}", str(path)) from error
