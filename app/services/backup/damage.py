"""What to do where the database's file is damaged: which backup to restore, and what each one lacks."""

from __future__ import annotations

from pathlib import Path

from app.errors import BackupRefused
from app.services.backup.latest import LatestBackup, read_latest_backup


def damage_advice(data_dir: Path) -> str:
    """Return the steps from the damaged database of a data folder to one that works, as far as they are known."""
    latest = noted_backup(data_dir)
    source = latest.folder if latest is not None else "LAST_BACKUP"
    steps = (
        f"Stop the service and keep the damaged files. Run `gridpose restore {source} --data-dir NEW`, with NEW a new "
        "folder, and start the service with it. Then run `gridpose upload` again, which sends what the service lacks. "
    )
    if latest is not None:
        steps += f"Results, readings and reports since {latest.created_at:%Y-%m-%d %H:%M} UTC are made anew. "
    copy = max(_copies(data_dir), key=lambda path: path.stem.rpartition("-")[2], default=None)
    if copy is not None:
        steps += (
            f"Only without any backup: {copy} is a copy of the database from before its schema was changed; all that "
            "was stored since then is lost with it (docs/backup.md)."
        )
    return steps.strip()


def noted_backup(data_dir: Path) -> LatestBackup | None:
    """Return the latest backup as far as the data folder says which it is."""
    try:
        return read_latest_backup(data_dir)
    except BackupRefused:
        return None


def _copies(data_dir: Path) -> list[Path]:
    try:
        return list((data_dir / "backups").glob("gridpose-*-*.sqlite3"))
    except OSError:
        return []
