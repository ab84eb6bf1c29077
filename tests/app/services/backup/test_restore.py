"""Restores: the same content, into an empty folder alone, and never from a damaged backup."""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.cli.server.backup import restore
from app.errors import InstallationRefused
from app.records.audit import list_entries
from app.records.database import Database
from app.records.rows import copy_rows
from app.services.backup import make_backup, read_manifest, restore_backup
from app.services.backup import restoring as restoring_module
from app.services.installation.context import ServiceContext
from app.services.keys import create_key, find_key, keys_in_force, revoke_key
from app.settings import Settings
from tests.support.service.backups import content, refused, upload
from tests.support.service.originals import original_path

_ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="names of open files are in /proc")


class _Killed(BaseException):
    """The end of a process in the midst of something: nothing tidies up."""


def _killed_before(name: str, do: Callable[[], object], monkeypatch: pytest.MonkeyPatch) -> None:
    """Do what ends when a file whose name begins so would be brought to the disk."""

    def sync(descriptor: int) -> None:
        if Path(f"/proc/self/fd/{descriptor}").readlink().name.startswith(name):
            raise _Killed
        fsync(descriptor)

    fsync = os.fsync
    with monkeypatch.context() as killed:
        killed.setattr(os, "fsync", sync)
        with pytest.raises(_Killed):
            do()


def test_what_is_restored_is_what_was_backed_up(
    any_api: Any, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """From SQLite to SQLite; from PostgreSQL to SQLite, and from there to another PostgreSQL database."""
    session_id = any_api.make_session()
    named = upload(any_api, session_id, 1, 2)
    before = content(any_api.installation.database)
    report = make_backup(any_api.installation, tmp_path / "backup")
    assert (report.copied, report.manifest.originals, report.manifest.missing) == (2, 2, [])
    assert report.manifest.rows == {name: len(rows) for name, rows in before.items()}

    settings = Settings(data_dir=tmp_path / "restored", workers=0)
    restore_backup(tmp_path / "backup", settings)
    installation = ServiceContext.open(settings, init=False)
    assert content(installation.database) == before
    for sha256 in named:
        assert hashlib.sha256(original_path(installation, sha256).read_bytes()).hexdigest() == sha256
    key = any_api.client.headers["Authorization"].removeprefix("Bearer ")
    assert find_key(installation, key) is not None
    for path in (settings.data_dir / "key-pepper", settings.data_dir / "gridpose.sqlite3"):
        assert path.stat().st_mode & 0o077 == 0
    if not any_api.installation.database.is_sqlite:
        make_backup(installation, tmp_path / "second")
        url = sa.make_url(any_api.installation.settings.database_url)
        with any_api.installation.database.engine.connect() as connection:
            connection.execution_options(isolation_level="AUTOCOMMIT")
            name = f"{url.database}_restored"
            connection.exec_driver_sql(f"CREATE DATABASE {name}")
        elsewhere = url.set(database=name).render_as_string(hide_password=False)
        try:
            again = Settings(data_dir=tmp_path / "again", workers=0, database_url=elsewhere)
            restore_backup(tmp_path / "second", again)
            postgres = ServiceContext.open(again, init=False)
            assert content(postgres.database) == before
            postgres.close()
            another = Settings(data_dir=tmp_path / "third", workers=0, database_url=elsewhere)
            assert refused(lambda: restore_backup(tmp_path / "second", another)) == "restore_not_empty"
        finally:
            with any_api.installation.database.engine.connect() as connection:
                connection.execution_options(isolation_level="AUTOCOMMIT")
                connection.exec_driver_sql(f"DROP DATABASE {name} WITH (FORCE)")
    installation.close()


def _flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize("part", ["database-*", "key-pepper-*", "originals/*/*", "manifest.json"])
def test_a_damaged_backup_is_not_restored(api: Any, tmp_path: Path, part: str) -> None:
    upload(api, api.make_session(), 1)
    folder = tmp_path / "backup"
    make_backup(api.installation, folder)
    (path,) = folder.glob(part)
    if part == "manifest.json":
        path.write_text(path.read_text()[:-20])
    else:
        _flip(path)
    settings = Settings(data_dir=tmp_path / "restored", workers=0)
    assert refused(lambda: restore_backup(folder, settings)) == "backup_damaged"
    if part == "manifest.json":
        return
    with pytest.raises(InstallationRefused) as caught:
        ServiceContext.open(settings)
    assert caught.value.code == "restore_incomplete"
    # The very restore may go on once the file is whole again, or where its loss is accepted.
    if part == "originals/*/*":
        _, damaged = restore_backup(folder, settings, accept_damage=True)
        assert damaged == [path.name]
    else:
        _flip(path)
        assert restore_backup(folder, settings)[1] == []
    installation = ServiceContext.open(settings, init=False)
    assert content(installation.database) == content(api.installation.database)
    installation.close()


@_ON_LINUX
@pytest.mark.parametrize("name", ["backup-of.json", "key-pepper", "manifest.json"])
def test_a_backup_that_ends_with_a_small_file_half_written_is_made_by_the_same_command(
    api: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    folder = tmp_path / "backup"
    _killed_before(name, lambda: make_backup(api.installation, folder), monkeypatch)
    assert any(path.name.startswith(name) for path in folder.iterdir())
    manifest = make_backup(api.installation, folder).manifest
    assert {path.name for path in folder.iterdir()} == {
        *("backup-of.json", "backup.lock", "manifest.json", "originals"),
        *(manifest.database, manifest.pepper),
    }


@_ON_LINUX
@pytest.mark.parametrize("name", ["restoring.json", "key-pepper", "installation.json"])
def test_a_restore_that_ends_with_a_small_file_half_written_is_continued(
    api: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    make_backup(api.installation, tmp_path / "backup")
    settings = Settings(data_dir=tmp_path / "restored", workers=0)
    _killed_before(name, lambda: restore_backup(tmp_path / "backup", settings), monkeypatch)
    assert any(path.name.startswith(f"{name}.") for path in settings.data_dir.iterdir())
    restore_backup(tmp_path / "backup", settings)
    left = [path.name for path in settings.data_dir.iterdir() if path.name.startswith(f"{name}.")]
    assert left == []
    ServiceContext.open(settings, init=False).close()


def test_only_an_empty_folder_that_nothing_uses_is_restored_into(api: Any, tmp_path: Path) -> None:
    make_backup(api.installation, tmp_path / "backup")
    used = api.installation.settings
    assert refused(lambda: restore_backup(tmp_path / "backup", used)) == "service_running"
    settings = Settings(data_dir=tmp_path / "other", workers=0)
    ServiceContext.open(settings).close()
    assert refused(lambda: restore_backup(tmp_path / "backup", settings)) == "restore_not_empty"
    stated = Settings(data_dir=tmp_path / "new", workers=0, key_pepper="another one")
    assert refused(lambda: restore_backup(tmp_path / "backup", stated)) == "pepper_changed"


def test_a_resumed_restore_needs_room_for_the_rest_alone(
    api: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    upload(api, api.make_session(), *range(1, 6))
    manifest = make_backup(api.installation, tmp_path / "backup").manifest
    settings = Settings(data_dir=tmp_path / "restored", workers=0)

    def die(*_arguments: Any) -> None:
        raise InterruptedError

    with monkeypatch.context() as broken:
        broken.setattr(restoring_module, "write_identity", die)
        with pytest.raises(InterruptedError):
            restore_backup(tmp_path / "backup", settings)
    left = settings.data_dir / "restoring.sqlite3.partial"
    left.touch()
    usage = type("Usage", (), {"free": 2 * manifest.database_bytes})
    monkeypatch.setattr("shutil.disk_usage", lambda _path: usage)
    other = Settings(data_dir=tmp_path / "other", workers=0)
    assert refused(lambda: restore_backup(tmp_path / "backup", other)) == "no_room"
    restore_backup(tmp_path / "backup", settings)
    assert not left.exists()
    installation = ServiceContext.open(settings, init=False)
    assert content(installation.database) == content(api.installation.database)
    installation.close()


@pytest.mark.parametrize("revoke", [False, True])
def test_keys_that_are_valid_again_are_named_or_revoked(
    any_api: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], revoke: bool
) -> None:
    new = create_key(any_api.installation, "revoked later", "upload")
    make_backup(any_api.installation, tmp_path / "backup")
    revoke_key(any_api.installation, new.key.id)
    assert restore(tmp_path / "backup", tmp_path / "restored", revoke_keys=revoke) == 0
    said = capsys.readouterr()
    installation = ServiceContext.open(Settings(data_dir=tmp_path / "restored", workers=0), init=False)
    assert (find_key(installation, new.secret_key) is None) is revoke
    if revoke:
        assert keys_in_force(installation) == []
        with installation.database.read() as records:
            entries = list_entries(records, limit=500, cursor=None)[0]
        (entry,) = [entry for entry in entries if entry.action == "revoke_keys"]
        assert new.key.id in entry.object_ids
    else:
        assert new.key.id in said.err
        assert "--revoke-keys" in said.err
    installation.close()


@pytest.mark.parametrize("delete", [False, True])
def test_webhooks_that_are_called_again_are_named_or_deleted(
    any_api: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], delete: bool
) -> None:
    webhook = {"name": "MES", "url": "https://plant.example/hook", "types": ["report.ready"]}
    made = any_api.client.post("/v1/webhooks", json=webhook).raise_for_status().json()
    any_api.client.post(f"/v1/webhooks/{made['id']}/test").raise_for_status()
    make_backup(any_api.installation, tmp_path / "backup")
    assert restore(tmp_path / "backup", tmp_path / "restored", delete_webhooks=delete) == 0
    said = capsys.readouterr()
    installation = ServiceContext.open(Settings(data_dir=tmp_path / "restored", workers=0), init=False)
    left = content(installation.database)
    assert bool(left["webhooks"]) is bool(left["webhook_deliveries"]) is not delete
    if delete:
        with installation.database.read() as records:
            entries = list_entries(records, limit=500, cursor=None)[0]
        (entry,) = [entry for entry in entries if entry.action == "delete_webhooks"]
        assert entry.object_ids == [made["id"]]
        assert "all deleted" in said.out
    else:
        assert "https://plant.example/hook" in said.err
        assert "--delete-webhooks" in said.err
    installation.close()


def test_a_disk_of_its_own_is_an_empty_folder(api: Any, tmp_path: Path) -> None:
    for name in ("backups", "data"):
        (tmp_path / name / "lost+found").mkdir(parents=True)
    make_backup(api.installation, tmp_path / "backups")
    restore_backup(tmp_path / "backups", Settings(data_dir=tmp_path / "data", workers=0))


def test_a_backup_of_another_format_is_refused(api: Any, tmp_path: Path) -> None:
    make_backup(api.installation, tmp_path / "backup")
    path = tmp_path / "backup" / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "format": 2}))
    assert refused(lambda: read_manifest(tmp_path / "backup")) == "backup_too_new"


@pytest.mark.postgres
def test_numbers_that_the_database_gives_go_on_after_copied_rows(postgres_url: str, tmp_path: Path) -> None:
    source, target = Database(f"sqlite:///{tmp_path / 'x.sqlite3'}"), Database(postgres_url)
    metadata = sa.MetaData()
    table = sa.Table("entries", metadata, sa.Column("id", sa.Integer(), primary_key=True))
    for database in (source, target):
        metadata.create_all(database.engine)
    with source.write() as records:
        records.execute(sa.insert(table), [{"id": 3}, {"id": 7}])
    with source.engine.connect() as given, target.engine.begin() as wanted:
        assert copy_rows(given, wanted) == {"entries": 2}
        assert wanted.scalar(sa.insert(table).returning(table.c.id)) == 8
    source.dispose()
    target.dispose()
