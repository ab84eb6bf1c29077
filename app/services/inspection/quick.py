"""The checks that take no time: without reading the whole database or any original."""

from __future__ import annotations

from app.services.inspection import backups, data_folder, database
from app.services.inspection.check_result import CheckResult, guarded
from app.settings import Settings


def inspect_quickly(settings: Settings) -> dict[str, list[CheckResult]]:
    """Return what was found, by subject; it writes and removes one small file, as every upload does."""
    folder = settings.data_dir
    return {
        "Data folder": guarded(data_folder.check(settings), folder),
        "Database": guarded(database.check(settings, whole=False), folder),
        "Backups": guarded(backups.check(settings), folder),
    }
