"""The checks that take no time: without reading the whole database or any original."""

from __future__ import annotations

from app.services.inspection import backups, data_folder, database
from app.services.inspection.check_result import CheckResult
from app.settings import Settings


def inspect_quickly(settings: Settings) -> dict[str, list[CheckResult]]:
    """Return what was found, by subject; it writes and removes one small file, as every upload does."""
    return {
        "Data folder": list(data_folder.check(settings)),
        "Database": list(database.check(settings, whole=False)),
        "Backups": list(backups.check(settings)),
    }
