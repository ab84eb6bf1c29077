"""What a complete backup consists of."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from app.blobs.durable import write_durably
from app.errors import BackupRefused
from app.records.privacy import OF_THE_FILE_SYSTEM

FORMAT = 1
_CHUNK = 1024 * 1024
MANIFEST, _OWNER = "manifest.json", "backup-of.json"
LEFT_BY_OTHERS = ("database-*", "key-pepper-*", f"{MANIFEST}.*", f"{_OWNER}.*")
"""What an earlier backup, or an interrupted one, may have left; the manifest's own files are among the first two."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """A backup's table of contents. Sizes are in bytes, hashes SHA-256 as 64 hex digits.

    `missing` and `corrupt` are the hashes of originals that rows name and that the installation itself no longer had,
    or had with other bytes.
    """

    format: int
    installation_id: str
    created_at: str
    core_version: str
    revision: str
    source: str
    database: str
    database_sha256: str
    database_bytes: int
    pepper: str
    pepper_sha256: str
    rows: dict[str, int]
    originals: int
    original_bytes: int
    missing: list[str]
    corrupt: list[str]


def read_manifest(folder: Path) -> Manifest | None:
    """Return the folder's complete backup, or None without one. Raises BackupRefused if it is not readable."""
    try:
        document = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise BackupRefused(
            "backup_damaged", f"{folder / MANIFEST} cannot be read.", "Use another backup."
        ) from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise BackupRefused(
            "backup_too_new",
            f"{folder} is a backup in a format that this version does not know.",
            "Install the version that made it, or a later one.",
        )
    names = {field.name for field in fields(Manifest)}
    if set(document) != names:
        raise BackupRefused(
            "backup_damaged", f"{folder / MANIFEST} is not a manifest.", "Use another backup."
        )
    return Manifest(**document)


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Make a backup complete."""
    write_durably(folder / MANIFEST, (json.dumps(asdict(manifest), indent=1) + "\n").encode())


def pepper_name(sha256: str) -> str:
    """Return the file that a backup keeps a pepper in: a later backup with another one leaves it until it is whole."""
    return f"key-pepper-{sha256[:16]}"


def claim_folder(folder: Path, installation_id: str) -> None:
    """Mark a folder as this installation's backup. Raises BackupRefused where it holds anything else."""
    owner = folder / _OWNER
    if owner.exists():
        try:
            named = json.loads(owner.read_text(encoding="utf-8"))["installation_id"]
        except (ValueError, KeyError, TypeError):
            named = "that cannot be read"
        if named == installation_id:
            return
        raise BackupRefused(
            "backup_foreign",
            f"{folder} holds a backup of another installation, {named}.",
            "Name another folder: one for each installation.",
        )
    # A process that was killed as it wrote the owner's file leaves its beginning under a longer name.
    if folder.exists() and any(
        path.name not in OF_THE_FILE_SYSTEM and not path.name.startswith(f"{_OWNER}.")
        for path in folder.iterdir()
    ):
        raise BackupRefused(
            "backup_foreign",
            f"{folder} is neither empty nor a backup.",
            "Name a new or an empty folder, or one that an earlier backup was made in.",
        )
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    write_durably(owner, (json.dumps({"installation_id": installation_id}) + "\n").encode())


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def copy_verified(source: Path, target: Path, sha256: str) -> bool:
    """Copy a file durably where its bytes have this hash; return whether they had. Its folder is not synced.

    Raises FileNotFoundError.
    """
    digest = hashlib.sha256()
    partial = target.with_name(target.name + ".partial")
    try:
        with source.open("rb") as reader, partial.open("wb") as writer:
            while chunk := reader.read(_CHUNK):
                digest.update(chunk)
                writer.write(chunk)
            if digest.hexdigest() != sha256:
                return False
            writer.flush()
            os.fsync(writer.fileno())
        partial.replace(target)
        return True
    finally:
        partial.unlink(missing_ok=True)
