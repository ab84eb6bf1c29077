"""Checks of the backups: there is one, it is recent, complete, in sight, and not on the disk that it is to replace."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from app.errors import BackupRefused, InstallationRefused
from app.services.backup import MANIFEST, LatestBackup, read_latest_backup
from app.services.inspection.check_result import CheckResult, ok, warn
from app.services.installation.identity import read_identity
from app.settings import Settings

MAX_AGE = timedelta(days=7)
_NEW = timedelta(days=1)
_MAX_CLOCK_STEP = timedelta(minutes=5)
"""How far a clock may be set back without a word."""
_DAILY = "Run `gridpose backup DIR` daily, with DIR on another disk (docs/operations.md has the timer)."


def check(settings: Settings) -> Iterator[CheckResult]:
    """Check when the last backup by `gridpose backup` was made, and that it is there; it is not opened."""
    try:
        latest = read_latest_backup(settings.data_dir)
    except BackupRefused as error:
        yield warn(error.detail, error.advice)
        return
    if latest is None:
        yield _none(settings)
        return
    yield _latest(latest)
    if latest.lacking:
        yield warn(
            f"{latest.lacking} originals were missing or damaged when it was made",
            "`gridpose doctor --deep` names them.",
        )
    if _on_same_disk(settings.data_dir, latest):
        yield warn("it is on the disk of the data folder, and is lost with it", _DAILY)


def _latest(latest: LatestBackup) -> CheckResult:
    """Judge the age of a backup that can be seen; of another, nothing is known."""
    age = datetime.now(UTC) - latest.created_at
    made = f"the latest is of {latest.created_at:%Y-%m-%d %H:%M} UTC, in {latest.folder}"
    if age > MAX_AGE:
        return warn(f"{made}: {age.days} days old", _DAILY)
    if age < -_MAX_CLOCK_STEP:
        return warn(
            f"{made}: ahead of this machine's clock",
            "Set the clock, best by NTP, then make a backup: until then nobody is warned of one that is too old.",
        )
    if not _is_there(latest):
        return warn(
            f"{made}, which cannot be seen from here: is its disk mounted?",
            "Mount it and run `gridpose doctor` again as the user that makes the backups. If it is lost, run "
            "`gridpose backup DIR` with another folder.",
        )
    return ok(made)


def _is_there(latest: LatestBackup) -> bool:
    """Return whether the folder has a complete backup: where a disk is not mounted, its empty folder is left."""
    try:
        return (Path(latest.folder) / MANIFEST).is_file()
    except OSError:
        return False


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
