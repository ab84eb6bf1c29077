"""The first admin key: written to a private file before it becomes valid, so that no crash loses it.

On a terminal the key is shown and the file removed. Elsewhere stdout may end in a log, so only the path is printed.
"""

from __future__ import annotations

import sys
from pathlib import Path

import sqlalchemy as sa

from app.blobs.durable import remove_file, write_durably
from app.logs import Logger
from app.records.activity import Activity, acting
from app.records.tables import ApiKey
from app.services.first_key import FIRST_KEY_FILE
from app.services.installation.context import ServiceContext
from app.services.keys import draft_key, find_key, store_key

log = Logger(__name__)


def ensure_admin_key(installation: ServiceContext) -> Path | None:
    """Create an admin key where there never was one.

    Returns the key's file, also that of an earlier start as long as it was not removed, else None.
    """
    if installation.settings.auth == "off":
        return None
    path = installation.settings.data_dir / FIRST_KEY_FILE
    if not _has_admin(installation):
        new = draft_key(installation, "first admin key", "admin")
        write_durably(path, f"{new.secret_key}\n".encode("ascii"))
        with acting(Activity(actor="cli", action="create_key")):
            store_key(installation, new)
        return path
    if not path.exists():
        return None
    try:
        key = path.read_text(encoding="ascii", errors="replace").strip()
    except OSError as error:  # of another owner: the service needs it no more
        log.warning("first_admin_key_unreadable", path=str(path), reason=error.strerror or str(error))
        return None
    if find_key(installation, key) is None:
        log.info("first_admin_key_file_removed", reason="the key in it is not valid")
        remove_file(path)
        return None
    return path


def announce_admin_key(path: Path) -> None:
    """Print the key on a terminal and remove its file; elsewhere print the path of the file."""
    if sys.stdout.isatty():
        print(f"  admin key  {path.read_text(encoding='ascii').strip()}")
        print("             shown only this once; `gridpose keys` creates and revokes others")
        path.unlink(missing_ok=True)
    else:
        print(f"  admin key  is in {path}")
        print(
            "             store it elsewhere and remove the file; `gridpose keys` creates and revokes others"
        )


def _has_admin(installation: ServiceContext) -> bool:
    with installation.database.read() as records:
        return records.scalar(sa.select(ApiKey.id).where(ApiKey.scope == "admin").limit(1)) is not None
