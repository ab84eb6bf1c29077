"""What to do where the database's file is damaged: which backup to restore, and what each one lacks."""

from __future__ import annotations

from pathlib import Path

from app.errors import BackupRefused
from app.services.backup.latest import LatestBackup, read_latest_backup
from app.settings import Settings


def damage_advice(settings: Settings) -> str:
    """Return the steps from the damaged database of an installation to one that works, as far as they are known."""
    data_dir = settings.data_dir
    latest = noted_backup(data_dir)
    place = (
        "a new folder"
        if settings.database_url is None
        else "a new folder and GRIDPOSE_DATABASE_URL a new database's"
    )
    source = latest.folder if latest is not None else "LAST_BACKUP"
    steps = (
        f"Stop the service and keep the damaged files. Run `gridpose restore {source} --data-dir NEW`, "
        f"with NEW {place}, and start the service with it. "
        "Then run `gridpose upload` again, which sends what the service lacks. "
    )
    if latest is not None:
        since = f"{latest.created_at:%Y-%m-%d %H:%M} UTC"
        steps += f"Enter readings and corrections since {since} again, and order the reports of that time. "
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
