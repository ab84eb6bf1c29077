"""Reports of an archive that the service once made, as it stored them, and the text of their sheets."""

from __future__ import annotations

import json
import tarfile
from typing import Any

import pypdfium2

from tests.reference.archives.make import FOLDER


def archived_report(kind: str) -> dict[str, Any]:
    with tarfile.open(FOLDER / "schema-0019.tar.gz") as archive:
        for member in archive:
            if member.name.endswith("/report.json"):
                document: dict[str, Any] = json.load(archive.extractfile(member))  # type: ignore[arg-type]
                if document["kind"] == kind:
                    return document
    raise LookupError(kind)


def pdf_text(content: bytes) -> str:
    text = " ".join(page.get_textpage().get_text_range() for page in pypdfium2.PdfDocument(content))
    return " ".join(text.split())
