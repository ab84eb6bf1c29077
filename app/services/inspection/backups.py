"""Checks of the backups: there is one, it is recent, complete, and not on the disk that it is to replace."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from app.errors import BackupRefused, InstallationRefused
from app.services.backup import LatestBackup, read_latest_backup
from app.services.inspection.check_result import CheckResult, ok, warn
from app.services.installation.identity import read_identity
from app.settings import Settings

MAX_AGE = timedelta(days=7)
_NEW = timedelta(days=1)
_DAILY = "Run `gridpose backup DIR` daily, with DIR on another disk (docs/backup.md has the timer)."


def check(settings: Settings) -> Iterator[CheckResult]:
    """Check when the last backup by `gridpose backup` was made, and where; it is not opened."""
    try:
        latest = read_latest_backup(settings.data_dir)
    except BackupRefused as error:
        yield warn(error.detail, error.advice)
        return
    if latest is None:
        yield _none(settings)
        return
    age = datetime.now(UTC) - latest.created_at
    made = f"the latest is of {latest.created_at:%Y-%m-%d %H:%M} UTC, in {latest.folder}"
    yield ok(made) if age <= MAX_AGE else warn(f"{made}: {age.days} days old", _DAILY)
    if latest.lacking:
        yield warn(
            f"{latest.lacking} originals were missing or damaged when it was made",
            "`gridpose doctor --deep` names them.",
        )
    if _on_same_disk(settings.data_dir, latest):
        yield warn("it is on the disk of the data folder, and is lost with it", _DAILY)


def _none(settings: Settings) -> CheckResult:
    try:
        identity = read_identity(settings.data_dir)
    except InstallationRefused:
        identity = None  # the check of the data folder reports it
    if identity is None or datetime.now(UTC) - identity.created_at < _NEW:
        return warn("none yet", _DAILY)
    return warn("none was made", _DAILY)


def _on_same_disk(data_dir: Path, latest: LatestBackup) -> bool:
    """Return whether both lie on one file system; False where the backup's folder is not to be seen from here."""
    try:
        return data_dir.stat().st_dev == Path(latest.folder).stat().st_dev
    except OSError:
        return False
