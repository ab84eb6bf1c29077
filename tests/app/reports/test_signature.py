"""Detached signatures: one file, one manifest, one key; anything else is noticed."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from app.cli.main import app
from app.reports.signature import SignatureUnreadable, check_file, fingerprint_of, sign_report, signing_key

CONTENT = b"%PDF-1.7"
KEY = signing_key(b"p" * 32)


def signed(**changes: Any) -> bytes:
    manifest = {
        "report_id": "rep_1",
        "kind": "camera",
        "session_id": "ses_1",
        "made_at": "2026-01-31T12:00:00+00:00",
        "core_version": "0.1.0",
        "forms": {"pdf": hashlib.sha256(CONTENT).hexdigest()},
        **changes,
    }
    return json.dumps(sign_report(KEY, manifest)).encode()


def test_a_signature_holds_for_its_file_and_key_alone() -> None:
    found = check_file(CONTENT, signed())
    assert (found.form, found.is_valid, found.fingerprint) == ("pdf", True, fingerprint_of(KEY))
    assert signing_key(b"p" * 32).private_bytes_raw() == KEY.private_bytes_raw()
    assert fingerprint_of(signing_key(b"q" * 32)) != found.fingerprint
    assert check_file(CONTENT + b" ", signed()).form is None
    forged = json.loads(signed())
    forged["manifest"]["made_at"] = "2020-01-01T00:00:00+00:00"
    assert not check_file(CONTENT, json.dumps(forged).encode()).is_valid
    other = json.loads(signed())
    other["public_key"] = json.loads(json.dumps(sign_report(signing_key(b"q" * 32), {})))["public_key"]
    assert not check_file(CONTENT, json.dumps(other).encode()).is_valid


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\xff\xfe",
        b"null",
        b"[]",
        b'{"manifest": []}',
        b"[" * 100_000,
        signed(report_id="\x1b[2J"),
        signed(kind=5),
    ],
)
def test_what_is_no_signature_is_refused(text: bytes) -> None:
    with pytest.raises(SignatureUnreadable):
        check_file(CONTENT, text)


def test_the_command_ends_with_1_for_a_changed_file_and_for_another_key(tmp_path: Path) -> None:
    path = tmp_path / "report.pdf"
    path.write_bytes(CONTENT)
    path.with_name("report.pdf.sig").write_bytes(signed())

    def verify(*options: str) -> int:
        return CliRunner().invoke(app, ["report", "verify", str(path), *options]).exit_code

    assert verify() == 0
    assert verify("--fingerprint", fingerprint_of(KEY)) == 0
    assert verify("--fingerprint", "0" * 64) == 1
    path.write_bytes(CONTENT + b" ")
    assert verify() == 1
