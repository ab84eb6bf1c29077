"""What an archive consists of, and the signature of it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from app.errors import ArchiveRefused
from app.records.ids import is_id
from app.reports.signature import SignatureUnreadable, check_manifest
from app.services.archive.container import damaged

FORMAT = "gridpose session archive"
FORMAT_VERSION = 1
README_NAME, MANIFEST_NAME, SIGNATURE_NAME = "README.txt", "manifest.json", "manifest.sig"
MAX_SMALL_BYTES = 64 * 1024 * 1024
"""Most bytes of README, manifest and signature: the manifest of 300,000 originals."""
_SHA256 = re.compile(r"[0-9a-f]{64}")
_ROWS = re.compile(r"rows/([a-z_]{1,60})\.jsonl")
_ORIGINAL = re.compile(r"originals/([0-9a-f]{64})\.[a-z]{3,4}")
_FORM = re.compile(r"reports/(rep_[0-9a-z]{26})/report\.([a-z]{3,4})")
_REVISION = re.compile(r"[0-9]{4}")


@dataclass(frozen=True, slots=True)
class ArchivedFile:
    """One file of an archive: its name, bytes, and SHA-256 as 64 hex digits."""

    name: str
    bytes: int
    sha256: str

    @property
    def table(self) -> str | None:
        """The table whose rows the file holds, None where it holds something else."""
        return _part(_ROWS, self.name)

    @property
    def original(self) -> str | None:
        """The hash that the original in the file was uploaded with, None where it holds something else."""
        return _part(_ORIGINAL, self.name)

    @property
    def form(self) -> tuple[str, str] | None:
        """The report and the form that the file holds, None where it holds something else."""
        found = _FORM.fullmatch(self.name)
        return None if found is None else (found[1], found[2])


@dataclass(frozen=True, slots=True, kw_only=True)
class ArchiveManifest:
    """An archive's table of contents, in the order of its members.

    `rows` counts each table's rows. `missing` are the hashes of originals that the installation no longer had, or had
    with other bytes.
    """

    format: str
    format_version: int
    session_id: str
    session_name: str
    made_at: str
    core_version: str
    revision: str
    installation_id: str
    rows: dict[str, int]
    missing: list[str]
    files: list[ArchivedFile]

    @property
    def originals(self) -> list[ArchivedFile]:
        """The originals in the archive."""
        return [file for file in self.files if file.original is not None]

    @property
    def reports(self) -> int:
        """How many reports are in the archive."""
        return self.rows.get("reports", 0)

    def encode(self) -> bytes:
        """Return the text of `manifest.json`."""
        return (json.dumps(self.document(), indent=1) + "\n").encode()

    def document(self) -> dict[str, Any]:
        """Return what is signed."""
        return asdict(self)


def decode_manifest(content: bytes, signature: bytes) -> tuple[ArchiveManifest, str]:
    """Return a manifest and the fingerprint of the key that signed it, 64 hex digits. Raises ArchiveRefused."""
    try:
        document = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise damaged("its manifest is no JSON") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise damaged("its manifest is that of another program")
    if document.get("format_version") != FORMAT_VERSION:
        raise ArchiveRefused(
            "archive_too_new",
            "The archive is in a format that this version does not know.",
            "Install the version that made it, or a later one.",
        )
    try:
        fingerprint = check_manifest(document, signature)
    except SignatureUnreadable as error:
        raise damaged(f"its signature cannot be read: {error}") from error
    if fingerprint is None:
        raise damaged("its manifest was changed after it was signed")
    if not _is_manifest(document):
        raise damaged("its manifest lacks fields, or has other ones")
    files = [ArchivedFile(**file) for file in document["files"]]
    return ArchiveManifest(**{**document, "files": files}), fingerprint


def _is_manifest(document: Mapping[str, Any]) -> bool:
    names = {field.name for field in fields(ArchiveManifest)}
    texts = ("session_id", "session_name", "made_at", "core_version", "revision", "installation_id")
    if set(document) != names or not all(
        isinstance(document[name], str) and document[name].isprintable() for name in texts
    ):
        return False
    rows, missing, files = document["rows"], document["missing"], document["files"]
    return (
        is_id(document["session_id"])
        and document["session_id"].startswith("ses_")
        and _REVISION.fullmatch(document["revision"]) is not None
        and isinstance(rows, dict)
        and all(_is_count(count) for count in rows.values())
        and isinstance(missing, list)
        and all(isinstance(sha256, str) and _SHA256.fullmatch(sha256) for sha256 in missing)
        and isinstance(files, list)
        and all(map(_is_file, files))
        and [file["name"] for file in files[: len(rows)]] == [f"rows/{name}.jsonl" for name in rows]
        and len({file["name"] for file in files}) == len(files)
    )


def _is_file(file: Any) -> bool:
    return (
        isinstance(file, dict)
        and set(file) == {"name", "bytes", "sha256"}
        and isinstance(file["name"], str)
        and any(pattern.fullmatch(file["name"]) for pattern in (_ROWS, _ORIGINAL, _FORM))
        and _is_count(file["bytes"])
        and isinstance(file["sha256"], str)
        and _SHA256.fullmatch(file["sha256"]) is not None
        and _part(_ORIGINAL, file["name"]) in (None, file["sha256"])
    )


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _part(pattern: re.Pattern[str], name: str) -> str | None:
    found = pattern.fullmatch(name)
    return None if found is None else found[1]


def read_me(manifest: ArchiveManifest) -> bytes:
    """Return the text that says to people what the archive is."""
    return "".join(_lines(manifest)).encode()


def _lines(manifest: ArchiveManifest) -> Iterator[str]:
    yield f'Session "{manifest.session_name}" ({manifest.session_id})\n'
    yield f"archived at {manifest.made_at} by Gridpose {manifest.core_version}\n\n"
    yield "Restore it on any installation of this or a later version, while the service runs:\n\n"
    yield "    gridpose sessions restore FILE --data-dir FOLDER\n\n"
    yield "manifest.json    every file with its size and SHA-256\n"
    yield "manifest.sig     the signature of the manifest: Ed25519, of the installation that made the archive\n"
    yield "rows/            the rows of the database, a JSON object in each line; bytes in base64\n"
    yield "originals/       the images as they were uploaded, each under its SHA-256\n"
    yield "reports/         the reports in all their forms; report.sig is the signature of each\n\n"
    for table, count in manifest.rows.items():
        yield f"{count:8d}  {table}\n"
    yield f"{len(manifest.originals):8d}  originals\n"
    if manifest.missing:
        yield f"\n{len(manifest.missing)} originals were missing or damaged when the archive was made:\n"
        yield from (f"    {sha256}\n" for sha256 in manifest.missing)
