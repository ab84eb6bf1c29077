"""Where and when the latest backup was made: `last-backup.json` in the data folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from app.blobs.durable import write_durably
from app.errors import BackupRefused
from app.logs import Logger
from app.services.backup.manifest import Manifest

FILE_NAME = "last-backup.json"

log = Logger(__name__)


@dataclass(frozen=True, slots=True)
class LatestBackup:
    """The moment that it holds, its folder, and how many originals it lacks."""

    created_at: datetime
    folder: str
    lacking: int


def note_backup(data_dir: Path, manifest: Manifest, folder: Path) -> None:
    """Note a complete backup. Where the data folder cannot be written, the log says so: the backup stands."""
    document = {
        "created_at": manifest.created_at,
        "folder": str(folder.absolute()),
        "lacking": len(manifest.missing) + len(manifest.corrupt),
    }
    try:
        write_durably(data_dir / FILE_NAME, (json.dumps(document, indent=1) + "\n").encode())
    except OSError as error:
        log.warning("backup_not_noted", path=str(data_dir / FILE_NAME), reason=error.strerror or str(error))


def read_latest_backup(data_dir: Path) -> LatestBackup | None:
    """Return the latest backup; None where none is noted.

    Raises BackupRefused where the note cannot be read.
    """
    path = data_dir / FILE_NAME
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        created_at = datetime.fromisoformat(document["created_at"])
        return LatestBackup(created_at, str(document["folder"]), int(document["lacking"]))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BackupRefused(
            "backup_note_unreadable",
            f"{path}, which says when the latest backup was made, cannot be read.",
            "Make backups as the user that the service runs as; the next one writes it anew.",
        ) from error
