"""The file of the first admin key, which lies in the data folder until somebody has stored the key elsewhere."""

from __future__ import annotations

import re
from pathlib import Path

from app.blobs.durable import remove_file
from app.logs import Logger

FIRST_KEY_FILE = "first-admin-key"
_KEY = re.compile(r"gp_([0-9a-z]{26})_[0-9a-f]{64}\s*", re.ASCII)

log = Logger(__name__)


def id_in(path: Path) -> str | None:
    """Return the id of the key in a file; None where it holds none. Raises OSError."""
    match = _KEY.fullmatch(path.read_text(encoding="ascii", errors="replace"))
    return f"key_{match[1]}" if match is not None else None


def forget_key(data_dir: Path, key_id: str) -> None:
    """Remove the file where it holds this key, which is valid no more."""
    path = data_dir / FIRST_KEY_FILE
    try:
        held = id_in(path)
    except OSError:
        return
    if held == key_id:
        log.info("first_admin_key_file_removed", reason="the key in it is revoked")
        remove_file(path)
