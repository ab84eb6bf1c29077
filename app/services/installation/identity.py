"""Which installation a data folder is: `installation.json`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from app.blobs.durable import write_durably
from app.errors import InstallationRefused
from app.records.ids import is_id


@dataclass(frozen=True, slots=True)
class Identity:
    """What `installation.json` says; `state` is `making` until the database has the same id."""

    id: str
    created_at: datetime
    state: Literal["making", "made"] = "made"


def identity_path(data_dir: Path) -> Path:
    """Return where a data folder says which installation it is."""
    return data_dir / "installation.json"


def read_identity(data_dir: Path) -> Identity | None:
    """Return which installation a data folder is; None where it does not say."""
    path = identity_path(data_dir)
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        identity = Identity(document["id"], datetime.fromisoformat(document["created_at"]), document["state"])
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise InstallationRefused(
            "installation_mismatch",
            f"{path} cannot be read as an installation's identity.",
            "Restore a backup, or put back the file as it was.",
        ) from error
    if not is_id(identity.id) or identity.state not in ("making", "made"):
        raise InstallationRefused(
            "installation_mismatch", f"{path} holds no installation id.", "Put back the file as it was."
        )
    return identity


def write_identity(data_dir: Path, identity: Identity) -> None:
    """Write which installation a data folder is."""
    document = {
        "id": identity.id,
        "created_at": identity.created_at.astimezone(UTC).isoformat(),
        "state": identity.state,
    }
    write_durably(identity_path(data_dir), (json.dumps(document, indent=1) + "\n").encode())
