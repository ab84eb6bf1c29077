"""Session archives that are not what was written: nothing of them is stored."""

from __future__ import annotations

import gzip
import json
import tarfile
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from app.reports.signature import fingerprint_of, sign_report, signing_key
from app.services.archive import restore_session
from app.services.archive.container import ArchiveWriter
from app.services.installation.context import ServiceContext
from tests.support.service.archives import is_untouched, members, rebuilt, refused, rename_first, replace_rows
from tests.support.service.service import Api


def is_same_content(one: bytes, whole: bytes) -> bool:
    """Whether a flipped bit says nothing: some bits of a deflate stream only fill up a byte."""
    try:
        return gzip.decompress(one) == gzip.decompress(whole)
    except (OSError, EOFError, zlib.error):
        return False


def test_every_change_of_the_file_is_found(archive: Path, other: ServiceContext, tmp_path: Path) -> None:
    whole = archive.read_bytes()
    path = tmp_path / "damaged.tar.gz"
    size = len(whole)
    flipped = [whole[:at] + bytes([whole[at] ^ 0x10]) + whole[at + 1 :] for at in range(40, size, size // 6)]
    changed = [one for one in flipped if not is_same_content(one, whole)]
    assert len(changed) >= 5
    cut = [whole[:at] for at in (0, 5, size // 2, size - 1)]
    for one in (
        *changed,
        *cut,
        whole + b"more",
        whole + whole,
        b"not gzip at all",
        gzip.compress(b"\xff" * 2048),
    ):
        path.write_bytes(one)
        assert refused(lambda: restore_session(other, path)) == "archive_damaged"
    assert is_untouched(other)


@pytest.mark.parametrize(
    "change",
    [
        rename_first("originals/", "originals/../../../escaped.png"),
        rename_first("originals/", "/etc/escaped.png"),
        rename_first("reports/", "reports/../escaped/report.pdf"),
        rename_first("rows/", "rows/api_keys.jsonl"),
        replace_rows("measurements", '"session_id":"ses_', '"session_id":"ses_0'),
        replace_rows("measurements", '"status":"succeeded"', '"status":"queued"'),
        replace_rows("measurements", '"bytes":', '"bytes":1'),
        replace_rows("measurements", '"cycle":1', '"cycle":1e400'),
        replace_rows("measurements", '"cycle":1', '"cycle":99999999999999999999'),
        replace_rows("results", '"points":"', '"points":"AAAA'),
        replace_rows("results", '"points":"', '"points":"\\u0000'),
        replace_rows("poses", '"position_mm":[1.0', '"position_mm":["1"'),
        replace_rows("sessions", '"name"', '"title"'),
        replace_rows("reports", '"report_id":"rep_', '"report_id":"rep_0'),
        lambda manifest, _: manifest["rows"].update(poses=99),
        lambda manifest, _: manifest["files"].pop(-2),
        lambda manifest, _: manifest.update(session_id="ses_x"),
        lambda manifest, _: manifest.update(missing=None),
        lambda manifest, _: manifest.update(format="another"),
        lambda _, found: found.update({next(n for n in found if n.startswith("originals/")): b"other bytes"}),
        lambda _, found: found.update({next(n for n in found if n.endswith(".pdf")): b"%PDF-forged"}),
        lambda _, found: found.update({"rows/robots.jsonl": b"[" * 100_000 + b"\n"}),
    ],
    ids=range(22),
)
def test_what_somebody_made_up_is_refused(
    archive: Path, other: ServiceContext, tmp_path: Path, change: Any
) -> None:
    path = rebuilt(archive, tmp_path / "foreign.tar.gz", change)
    assert refused(lambda: restore_session(other, path)) == "archive_damaged"
    assert is_untouched(other)
    assert not list(tmp_path.rglob("*escaped*"))


def test_names_of_members_lead_nowhere(archive: Path, other: ServiceContext, tmp_path: Path) -> None:
    path = rebuilt(
        archive, tmp_path / "a.tar.gz", lambda *_: None, names=lambda name: name.replace("originals", "../..")
    )
    assert refused(lambda: restore_session(other, path)) == "archive_damaged"
    assert is_untouched(other)


def test_links_and_extended_headers_are_refused(other: ServiceContext, tmp_path: Path) -> None:
    path = tmp_path / "links.tar.gz"
    for kind in (
        tarfile.SYMTYPE,
        tarfile.LNKTYPE,
        tarfile.DIRTYPE,
        tarfile.XHDTYPE,
        tarfile.GNUTYPE_LONGNAME,
    ):
        with tarfile.open(path, "w:gz") as tar:
            header = tarfile.TarInfo("README.txt")
            header.type, header.linkname = kind, "/etc/passwd"
            tar.addfile(header, BytesIO())
        assert refused(lambda: restore_session(other, path)) == "archive_damaged"


def test_a_stream_without_end_is_not_read(archive: Path, other: ServiceContext, tmp_path: Path) -> None:
    path = tmp_path / "bomb.tar.gz"
    header = tarfile.TarInfo("README.txt")
    header.size = 8 * 1024**3 - 1
    with gzip.open(path, "wb", compresslevel=9) as bomb:
        bomb.write(header.tobuf(tarfile.USTAR_FORMAT))
    assert refused(lambda: restore_session(other, path)) == "archive_damaged"

    def announce(manifest: dict[str, Any], _: dict[str, bytes]) -> None:
        manifest["files"][-1]["bytes"] = 10**15

    found = dict(members(archive))
    manifest = json.loads(found["manifest.json"])
    announce(manifest, found)
    with path.open("wb") as file:
        writer = ArchiveWriter(file, 0)
        writer.add_bytes("README.txt", b"")
        writer.add_bytes("manifest.json", json.dumps(manifest).encode())
        writer.add_bytes("manifest.sig", json.dumps(sign_report(signing_key(b"x"), manifest)).encode())
        writer.close()
    assert refused(lambda: restore_session(other, path)) == "no_room"
    assert is_untouched(other)


def test_only_archives_of_a_trusted_key_are_taken_where_one_is_named(
    source: Api, archive: Path, other: ServiceContext, tmp_path: Path
) -> None:
    trusted = fingerprint_of(signing_key(source.installation.pepper))
    forged = rebuilt(archive, tmp_path / "forged.tar.gz", replace_rows("sessions", "Zelle", "Halle"))
    assert refused(lambda: restore_session(other, forged, trusted=trusted)) == "archive_foreign"
    assert is_untouched(other)
    assert restore_session(other, archive, trusted=trusted.upper()).fingerprint == trusted


@pytest.mark.parametrize("changes", [{"format_version": 2}, {"revision": "9999"}], ids=["format", "schema"])
def test_an_archive_of_a_later_version_says_so(
    archive: Path, other: ServiceContext, tmp_path: Path, changes: dict[str, Any]
) -> None:
    path = rebuilt(archive, tmp_path / "new.tar.gz", lambda manifest, _: manifest.update(changes))
    assert refused(lambda: restore_session(other, path)) == "archive_too_new"
    assert is_untouched(other)
