"""Session archives: everything of a session, byte for byte, in another installation."""

from __future__ import annotations

import errno
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.errors import ArchiveRefused, NotFound
from app.records import migrations
from app.records.database import Database
from app.records.file_lock import FileLock
from app.records.rows import tables_in
from app.records.tables import AuditEntry, Measurement, MeasurementChange, Robot, Table
from app.reports.signature import fingerprint_of, signing_key
from app.services.archive import archive_session, restore_session
from app.services.archive.copying import put_rows
from app.services.archive.rows import OF_SESSION
from app.services.installation.context import ServiceContext
from app.services.originals import remove_unreferenced
from app.services.sessions import delete_session
from tests.support.service.archives import is_untouched, members, rebuilt, refused, rows, store
from tests.support.service.backups import image
from tests.support.service.service import Api
from tests.support.sessions.stored_sessions import BOARD, board_fields, shoot, store_shots


def test_a_session_is_restored_elsewhere_byte_for_byte(
    source: Api, session_id: str, archive: Path, other: ServiceContext, tmp_path: Path
) -> None:
    restored = restore_session(other, archive)
    assert restored.manifest.session_id == session_id
    assert restored.already_there == {}
    assert restored.fingerprint == fingerprint_of(signing_key(source.installation.pepper))
    before, after = rows(source.installation), rows(other)
    assert {name: len(found) for name, found in after.items() if found} == restored.manifest.rows
    assert after == before
    for row in before["measurements"]:
        assert other.blobs.is_whole(row["sha256"], row["bytes"])
    with other.database.read() as records:
        (entry,) = records.scalars(sa.select(AuditEntry).where(AuditEntry.action == "restore_session"))
        assert entry.object_ids[0] == session_id
    again = tmp_path / "again.tar.gz"
    archive_session(other, session_id, again)
    differing = [one for one, two in zip(members(archive), members(again), strict=True) if one != two]
    assert {name for name, _ in differing} <= {"README.txt", "manifest.json", "manifest.sig"}
    assert not [path for path in other.settings.data_dir.iterdir() if path.name.startswith("restoring")]


def test_the_archive_is_a_plain_tar_that_people_can_read(archive: Path, session_id: str) -> None:
    found = dict(members(archive))
    assert f"({session_id})" in found["README.txt"].decode()
    manifest = json.loads(found["manifest.json"])
    assert [file["name"] for file in manifest["files"]] == list(found)[3:]
    for file in manifest["files"]:
        data = found[file["name"]]
        assert (len(data), hashlib.sha256(data).hexdigest()) == (file["bytes"], file["sha256"])
    originals = {name for name in found if name.startswith("originals/")}
    assert {name.rpartition(".")[2] for name in originals} == {"png"}
    assert len(originals) == 4
    assert sum(name.endswith("report.pdf") for name in found) == 1
    assert json.loads(found["rows/sessions.jsonl"])["name"] == "Zelle 4 \u00e4"


def test_a_session_that_was_deleted_comes_back_with_its_reports(
    source: Api, session_id: str, archive: Path, other: ServiceContext
) -> None:
    restore_session(other, archive)
    assert refused(lambda: restore_session(other, archive)) == "session_present"
    delete_session(other.database, other.blobs, session_id)
    restored = restore_session(other, archive)
    assert restored.already_there == {
        "robots": 1,
        "targets": 1,
        "reports": 1,
        "report_forms": 2,
        "qualifications": 1,
        "robot_events": 1,
    }
    assert rows(other) == rows(source.installation)


def test_a_robot_that_was_changed_meanwhile_is_not_taken_for_the_archived_one(
    session_id: str, archive: Path, other: ServiceContext
) -> None:
    restore_session(other, archive)
    delete_session(other.database, other.blobs, session_id)
    with other.database.write() as records:
        records.execute(sa.update(Robot).values(name="another name"))
    restore_session(other, archive)
    delete_session(other.database, other.blobs, session_id)
    with other.database.write() as records:
        records.execute(sa.update(Robot).values(datasheet_repeatability_mm=0.1))
    with pytest.raises(ArchiveRefused, match="datasheet_repeatability_mm") as caught:
        restore_session(other, archive)
    assert caught.value.code == "archive_conflict"
    assert not [path for path in (other.settings.data_dir / "originals").glob("*/*") if path.is_file()]


def test_no_archive_of_a_session_that_is_not_finished_or_not_there(api: Api, tmp_path: Path) -> None:
    path = tmp_path / "new.tar.gz"
    with pytest.raises(NotFound):
        archive_session(api.installation, "ses_" + "0" * 26, path)
    with pytest.raises(NotFound):
        archive_session(api.installation, "../../etc", path)
    session = api.make_session()
    assert api.put_image(session, image(7)).status_code == 202
    assert refused(lambda: archive_session(api.installation, session, path)) == "session_unfinished"
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_replaced_only_on_request(source: Api, session_id: str, tmp_path: Path) -> None:
    path = tmp_path / "thesis.tar.gz"
    path.write_bytes(b"precious")
    assert refused(lambda: archive_session(source.installation, session_id, path)) == "archive_exists"
    assert path.read_bytes() == b"precious"
    archive_session(source.installation, session_id, path, replace=True)
    assert [one.name for one in tmp_path.iterdir()] == ["thesis.tar.gz"]


def test_a_session_is_archived_by_its_name(api: Api, tmp_path: Path) -> None:
    wanted, one, two = api.make_session(), api.make_session(), api.make_session()
    for session, name in ((wanted, "Cell 7"), (one, "Cell 8"), (two, "Cell 8")):
        assert api.client.patch(f"/v1/sessions/{session}", json={"name": name}).status_code == 200
    archived = archive_session(api.installation, "Cell 7", tmp_path / "7.tar.gz")
    assert archived.manifest.session_id == wanted
    path = tmp_path / "8.tar.gz"
    assert refused(lambda: archive_session(api.installation, "Cell 8", path)) == "session_ambiguous"
    with pytest.raises(NotFound):
        archive_session(api.installation, "Cell", path)


def test_a_file_that_cannot_be_written_is_the_archives_failure(
    source: Api, session_id: str, tmp_path: Path
) -> None:
    absent = tmp_path / "not mounted" / "new.tar.gz"
    assert refused(lambda: archive_session(source.installation, session_id, absent)) == "archive_unwritable"
    assert refused(lambda: archive_session(source.installation, session_id, Path("/dev/full/a"))) == (
        "archive_unwritable"
    )


def test_a_disk_that_fills_is_the_archives_failure(
    source: Api, session_id: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / "new.tar.gz"
    monkeypatch.setattr(os, "fsync", full)
    assert refused(lambda: archive_session(source.installation, session_id, path)) == "archive_unwritable"
    assert list(tmp_path.iterdir()) == []


def test_originals_that_are_lost_are_named(api: Api, tmp_path: Path, other: ServiceContext) -> None:
    target = api.make_target(**board_fields(BOARD))
    session = api.make_session(target)
    store_shots(api, session, shoot(poses=1, cycles=2), target)  # whose originals were never there
    archived = archive_session(api.installation, session, tmp_path / "lossy.tar.gz")
    assert len(archived.manifest.missing) == 2
    restored = restore_session(other, tmp_path / "lossy.tar.gz")
    assert restored.manifest.missing == archived.manifest.missing
    with other.database.read() as records:
        assert records.scalar(sa.select(sa.func.count()).select_from(Measurement)) == 2


def test_an_archive_of_an_earlier_schema_is_migrated(
    archive: Path, other: ServiceContext, tmp_path: Path
) -> None:
    """Rows as schema 0019 has them: what later ones add is as their migrations make it."""
    old = Database(f"sqlite:///{tmp_path / 'old.sqlite3'}")
    migrations.upgrade(old, tmp_path, revision="0019", copy_first=False)
    with old.engine.connect() as connection:
        known = {name: set(table.c.keys()) for name, table in tables_in(connection).items()}
    old.dispose()

    def as_then(manifest: dict[str, Any], found: dict[str, bytes]) -> None:
        manifest["revision"] = "0019"
        manifest["rows"] = {name: count for name, count in manifest["rows"].items() if name in known}
        manifest["files"] = [
            file
            for file in manifest["files"]
            if not file["name"].startswith("rows/") or file["name"][5:-6] in known
        ]
        for name, columns in known.items():
            lines = found.get(f"rows/{name}.jsonl", b"").splitlines()
            kept = [{k: v for k, v in json.loads(line).items() if k in columns} for line in lines]
            found[f"rows/{name}.jsonl"] = b"".join(json.dumps(row).encode() + b"\n" for row in kept)

    restored = restore_session(other, rebuilt(archive, tmp_path / "old.tar.gz", as_then))
    found = {name: len(found) for name, found in rows(other).items() if found}
    assert found == {name: count for name, count in restored.manifest.rows.items() if count}


def test_every_table_that_names_a_session_is_archived() -> None:
    """A new table of a session's rows belongs into `OF_SESSION`, or its rows are not in archives."""
    names = {table.__tablename__ for table in OF_SESSION}
    for table in Table.metadata.sorted_tables:
        refers = {key.column.table.name for key in table.foreign_keys} & {
            "sessions",
            "measurements",
            "reports",
        }
        if (
            "session_id" in table.c or refers
        ) and table.name != MeasurementChange.__tablename__:  # by triggers
            assert table.name in names


def test_a_failed_transaction_leaves_no_original(
    archive: Path, other: ServiceContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(Exception):
        pass

    def die(*_arguments: Any) -> None:
        raise Killed

    monkeypatch.setattr("app.services.archive.restoring.put_rows", die)
    with pytest.raises(Killed):
        restore_session(other, archive)
    assert is_untouched(other)
    monkeypatch.undo()
    restore_session(other, archive)


def test_an_original_removed_in_between_is_put_back(
    archive: Path, other: ServiceContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A deletion of the same bytes that was recorded before the restore is finished before its rows are there."""
    from app.services.archive import restoring

    def remove_first(*arguments: Any) -> Any:
        hashes = [path.name for path in (other.settings.data_dir / "originals").glob("*/*") if path.is_file()]
        remove_unreferenced(other.database, other.blobs, hashes)
        return put_rows(*arguments)

    monkeypatch.setattr(restoring, "put_rows", remove_first)
    restore_session(other, archive)
    with other.database.read() as records:
        for sha256, size in records.execute(sa.select(Measurement.sha256, Measurement.bytes)):
            assert other.blobs.is_whole(sha256, size)
    assert not list((other.settings.data_dir / "originals" / "incoming").iterdir())


def test_either_database_gives_and_takes_archives(
    any_api: Api, other: ServiceContext, tmp_path: Path
) -> None:
    """From SQLite or PostgreSQL to SQLite, and back after the session was deleted there."""
    here, path = any_api.installation, tmp_path / "there.tar.gz"
    session = store(any_api)
    before = rows(here)
    archive_session(here, session, path)
    restore_session(other, path)
    assert rows(other) == before
    delete_session(here.database, here.blobs, session)
    back = tmp_path / "back.tar.gz"
    archive_session(other, session, back)
    assert restore_session(here, back).already_there["reports"] == 1
    assert rows(here) == before
    assert (
        any_api.client.get(f"/v1/sessions/{session}/measurements").json()["items"][0]["status"] == "succeeded"
    )


def test_what_a_killed_restore_left_is_removed_and_what_another_uses_is_not(
    archive: Path, other: ServiceContext
) -> None:
    left, used = (other.settings.data_dir / f"restoring-session-{name}" for name in ("left", "used"))
    for folder in (left, used):
        folder.mkdir()
        (folder / "rows.sqlite3").write_bytes(b"half")
    with FileLock(used / "restoring.lock"):
        restore_session(other, archive)
        assert not left.exists()
        assert (used / "rows.sqlite3").exists()
