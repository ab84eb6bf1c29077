"""Backups: what they hold, what they forget, and that an unfinished one leaves the earlier one whole."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from app.blobs.local import LocalBlobs, original_path
from app.errors import BackupRefused, StorageFull
from app.records import migrations
from app.records.database import Database
from app.records.file_lock import FileLock
from app.services.backup import make_backup, read_manifest, restore_backup
from app.services.backup import making as making_module
from app.services.installation.context import ServiceContext
from app.services.keys import create_key, find_key
from app.settings import Settings
from tests.support.service.backups import content, image, refused, upload


def test_a_later_backup_copies_what_is_new_and_forgets_what_is_gone(api: Any, tmp_path: Path) -> None:
    folder = tmp_path / "backup"
    first, second = api.make_session(), api.make_session()
    (gone,) = upload(api, first, 1)
    (kept,) = upload(api, second, 2)
    make_backup(api.installation, folder)
    inode = original_path(folder / "originals", kept).stat().st_ino
    assert api.client.delete(f"/v1/sessions/{first}").status_code == 204
    (new,) = upload(api, second, 3)
    report = make_backup(api.installation, folder)
    assert (report.copied, report.copied_bytes) == (1, len(image(3)))
    files = {path.name: path for path in (folder / "originals").rglob("*") if path.is_file()}
    assert set(files) == {kept, new}
    assert gone not in files
    assert files[kept].stat().st_ino == inode
    (database,) = folder.glob("database-*")
    assert database.name == report.manifest.database


def test_a_folder_of_something_else_is_left_alone(api: Any, open_api: Any, tmp_path: Path) -> None:
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.tex").touch()
    assert refused(lambda: make_backup(api.installation, foreign)) == "backup_foreign"
    assert [path.name for path in foreign.iterdir()] == ["thesis.tex"]
    make_backup(api.installation, tmp_path / "backup")
    other = ServiceContext.open(Settings(data_dir=tmp_path / "other", workers=0))
    assert refused(lambda: make_backup(other, tmp_path / "backup")) == "backup_foreign"
    other.close()
    with FileLock(tmp_path / "backup" / "backup.lock"):
        assert refused(lambda: make_backup(api.installation, tmp_path / "backup")) == "backup_folder_in_use"


def test_an_older_copy_of_the_installation_leaves_the_newer_backup_alone(api: Any, tmp_path: Path) -> None:
    folder, session = tmp_path / "backup", api.make_session()
    upload(api, session, 1)
    make_backup(api.installation, folder)
    settings = Settings(data_dir=tmp_path / "drill", workers=0)
    restore_backup(folder, settings)
    drill = ServiceContext.open(settings, init=False)
    make_backup(drill, folder)  # whoever restored the latest backup goes on with it
    upload(api, session, 2)
    newer = make_backup(api.installation, folder).manifest
    files = sorted(path for path in folder.rglob("*"))
    assert refused(lambda: make_backup(drill, folder)) == "backup_newer"
    assert sorted(path for path in folder.rglob("*")) == files
    assert read_manifest(folder) == newer
    assert make_backup(drill, folder, replace_newer=True).manifest.originals == 1
    drill.close()
    assert make_backup(api.installation, folder).manifest.originals == 2


def test_a_copy_that_went_another_way_leaves_the_backup_alone(api: Any, tmp_path: Path) -> None:
    folder = tmp_path / "backup"
    session = api.make_session()
    upload(api, session, 1)
    make_backup(api.installation, folder)
    settings = Settings(data_dir=tmp_path / "copy", workers=0)
    restore_backup(folder, settings, revoke_keys=True)
    copy = ServiceContext.open(settings, init=False)
    make_backup(copy, folder)
    copy.close()
    upload(api, session, 2)
    assert refused(lambda: make_backup(api.installation, folder)) == "backup_newer"


def test_a_damaged_backup_may_be_replaced(api: Any, tmp_path: Path) -> None:
    folder = tmp_path / "backup"
    for damaged in ("database", "manifest"):
        name = make_backup(api.installation, folder).manifest.database
        (folder / (name if damaged == "database" else "manifest.json")).write_bytes(b"no such thing" * 100)
        make_backup(api.installation, folder)


def test_an_interrupted_backup_leaves_the_earlier_one_whole(
    api: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "backup"
    session = api.make_session()
    upload(api, session, 1)

    class Killed(Exception):
        pass

    def die(*_arguments: Any) -> None:
        raise Killed

    with monkeypatch.context() as broken:
        broken.setattr(making_module, "write_manifest", die)
        with pytest.raises(Killed):
            make_backup(api.installation, folder)
    settings = Settings(data_dir=tmp_path / "restored", workers=0)
    assert refused(lambda: restore_backup(folder, settings)) == "backup_incomplete"
    make_backup(api.installation, folder)
    before = content(api.installation.database)
    upload(api, session, 2)
    with monkeypatch.context() as broken:
        broken.setattr(making_module, "write_manifest", die)
        with pytest.raises(Killed):
            make_backup(api.installation, folder)
    restore_backup(folder, settings)
    installation = ServiceContext.open(settings, init=False)
    assert content(installation.database) == before
    installation.close()


def test_originals_that_are_missing_or_corrupt_are_named(api: Any, tmp_path: Path) -> None:
    session = api.make_session()
    missing, corrupt, whole = upload(api, session, 1, 2, 3)
    api.installation.blobs.path(missing).unlink()
    path = api.installation.blobs.path(corrupt)
    path.write_bytes(bytes([path.read_bytes()[0] ^ 1, *path.read_bytes()[1:]]))
    manifest = make_backup(api.installation, tmp_path / "backup").manifest
    assert (manifest.missing, manifest.corrupt, manifest.originals) == ([missing], [corrupt], 1)
    settings = Settings(data_dir=tmp_path / "restored", workers=0)
    restore_backup(tmp_path / "backup", settings)
    blobs = LocalBlobs(settings.data_dir / "originals")
    assert [blobs.path(sha256).exists() for sha256 in (missing, corrupt, whole)] == [False, False, True]


def test_what_is_deleted_during_a_backup_is_not_in_it(
    api: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The session goes between the moment of the rows and the copying of its image: another moment is taken."""
    session, kept = api.make_session(), api.make_session()
    upload(api, session, 1)
    (staying,) = upload(api, kept, 2)
    copy = migrations.copy_to_file

    def copy_and_delete(database: Database, path: Path) -> None:
        copy(database, path)
        api.client.delete(f"/v1/sessions/{session}")

    monkeypatch.setattr(migrations, "copy_to_file", copy_and_delete)
    manifest = make_backup(api.installation, tmp_path / "backup").manifest
    assert (manifest.missing, manifest.originals, manifest.rows["sessions"]) == ([], 1, 1)
    files = [path.name for path in (tmp_path / "backup" / "originals").rglob("*") if path.is_file()]
    assert files == [staying]


def test_a_backup_with_a_new_pepper_leaves_the_earlier_one_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(*_arguments: Any) -> None:
        raise InterruptedError

    folder, settings = tmp_path / "backup", Settings(data_dir=tmp_path / "data", workers=0)
    installation = ServiceContext.open(settings)
    key = create_key(installation, "k", "admin").secret_key
    make_backup(installation, folder)
    installation.close()
    (settings.data_dir / "key-pepper").unlink()
    installation = ServiceContext.open(settings, adopt=True)
    with monkeypatch.context() as broken:
        broken.setattr(making_module, "write_manifest", die)
        with pytest.raises(InterruptedError):
            make_backup(installation, folder)
    former = Settings(data_dir=tmp_path / "former", workers=0)
    restore_backup(folder, former)
    restored = ServiceContext.open(former, init=False)
    assert find_key(restored, key) is not None
    restored.close()
    manifest = make_backup(installation, folder).manifest
    assert [path.name for path in folder.glob("key-pepper*")] == [manifest.pepper]
    installation.close()
    restore_backup(folder, Settings(data_dir=tmp_path / "later", workers=0))


def test_an_unfinished_copy_goes_with_the_next_one(api: Any, tmp_path: Path) -> None:
    for suffix in ("", "-wal"):
        (tmp_path / f"gridpose-0007-20200101T000000.000000Z.sqlite3.partial{suffix}").touch()
    copy = migrations.back_up(api.installation.database, tmp_path, "0008")
    assert list(tmp_path.glob("gridpose-*")) == [copy]


def test_too_little_room_is_said_before_anything_is_copied(
    api: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    upload(api, api.make_session(), 1)
    make_backup(api.installation, tmp_path / "whole")
    real = os.statvfs(tmp_path)

    def nearly_full(_path: Any) -> Any:
        return type("Usage", (), {"total": real.f_blocks, "used": 0, "free": 100})

    monkeypatch.setattr("shutil.disk_usage", nearly_full)
    assert refused(lambda: make_backup(api.installation, tmp_path / "backup")) == "no_room"
    assert read_manifest(tmp_path / "backup") is None
    settings = Settings(data_dir=tmp_path / "restored", workers=0)
    assert refused(lambda: restore_backup(tmp_path / "whole", settings)) == "no_room"
    with pytest.raises(migrations.NoRoomForCopy):
        migrations.back_up(api.installation.database, tmp_path / "copies", "0008")


def test_a_disk_that_fills_under_the_copy_is_the_backups(
    api: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_arguments: Any) -> None:
        raise StorageFull

    monkeypatch.setattr(migrations, "copy_to_file", full)
    with pytest.raises(BackupRefused, match=str(tmp_path / "backup")) as caught:
        make_backup(api.installation, tmp_path / "backup")
    assert caught.value.code == "no_room"
