"""What is found of an installation: its backups, and how the System page says it."""

from __future__ import annotations

import errno
import json
import os
import shutil
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from app.services.backup import make_backup, read_latest_backup
from app.services.backup.latest import FILE_NAME
from app.services.inspection import State, backups, data_folder, database, inspect_quickly
from app.services.installation.identity import Identity, read_identity, write_identity
from app.services.keys import create_key, keys_in_force, revoke_key
from tests.support.service.signed_in import signed_in


def found(api: Any) -> list[tuple[State, str]]:
    return [(one.state, one.detail) for one in backups.check(api.installation.settings)]


def aged(api: Any, days: float) -> None:
    folder = api.installation.settings.data_dir
    identity = read_identity(folder)
    assert identity is not None
    write_identity(folder, Identity(identity.id, datetime.now(UTC) - timedelta(days=days)))


def test_an_installation_without_a_backup_is_never_called_well(api: Any) -> None:
    assert found(api) == [(State.warning, "none yet")]
    aged(api, 2.0)
    assert found(api) == [(State.warning, "none was made")]


def test_a_backup_is_noted_with_its_moment_and_folder(api: Any, tmp_path: Path) -> None:
    report = make_backup(api.installation, tmp_path / "copy")
    latest = read_latest_backup(api.installation.settings.data_dir)
    assert latest is not None
    assert latest.created_at.isoformat() == report.manifest.created_at
    assert (latest.folder, latest.lacking) == (str(tmp_path / "copy"), 0)
    (made, where) = found(api)
    assert made[0] is State.ok
    assert str(tmp_path / "copy") in made[1]
    # In a test both lie on one disk.
    assert where == (State.warning, "it is on the disk of the data folder, and is lost with it")


@pytest.mark.parametrize(
    ("change", "state"),
    [
        ({"created_at": "2020-01-01T00:00:00+00:00"}, State.warning),
        ({}, State.ok),
        ({"lacking": 3}, State.warning),
        ({"folder": "/nowhere/to/be/seen"}, State.warning),
        ({"created_at": "2999-01-01T00:00:00+00:00"}, State.warning),
    ],
)
def test_an_old_or_incomplete_backup_is_reported(
    api: Any, tmp_path: Path, change: dict[str, Any], state: State
) -> None:
    make_backup(api.installation, tmp_path / "copy")
    note = api.installation.settings.data_dir / FILE_NAME
    note.write_text(json.dumps({**json.loads(note.read_text()), **change}))
    on_same_disk = (State.warning, "it is on the disk of the data folder, and is lost with it")
    assert max(one.value for one, detail in found(api) if (one, detail) != on_same_disk) == state.value


def test_a_folder_that_is_empty_because_its_disk_is_not_mounted_holds_no_backup(
    api: Any, tmp_path: Path
) -> None:
    make_backup(api.installation, tmp_path / "disk")
    (tmp_path / "disk").rename(tmp_path / "elsewhere")
    (tmp_path / "disk").mkdir()
    assert "is its disk mounted?" in found(api)[0][1]


def test_a_note_that_cannot_be_read_is_no_missing_backup(api: Any) -> None:
    (api.installation.settings.data_dir / FILE_NAME).write_text("{")
    ((state, detail),) = found(api)
    assert state is State.warning
    assert "cannot be read" in detail


def test_the_system_page_shows_what_was_found_and_what_to_do(api: Any) -> None:
    page = api.client.get("/ui/system", headers=signed_in(api)).text
    assert "belong to installation" in page
    assert "schema" in page
    assert "none yet<br>" in page
    aged(api, 2.0)
    page = api.client.get("/ui/system", headers=signed_in(api)).text
    assert "none was made" in page
    assert "Run <code>gridpose backup DIR</code> daily" in page
    assert "below" in page
    quick = inspect_quickly(api.installation.settings)
    assert set(quick) == {"Data folder", "Database", "Backups"}
    assert not any(one.state is State.failed for part in quick.values() for one in part)


def test_a_missing_admin_key_is_reported_expired_ones_do_not_count(any_api: Any) -> None:
    def keys() -> tuple[State, str]:
        results = database.check(any_api.installation.settings, whole=False)
        (one,) = [one for one in results if "API key" in one.detail]
        return one.state, one.detail

    (admin,) = keys_in_force(any_api.installation)
    create_key(any_api.installation, "dashboard", "read")
    create_key(any_api.installation, "service", "admin", expires_in=timedelta(days=-1))
    assert keys() == (State.ok, "API keys in force: 2")
    revoke_key(any_api.installation, admin.id)
    assert keys() == (State.warning, "no API key in force has the scope admin")
    for key in keys_in_force(any_api.installation):
        revoke_key(any_api.installation, key.id)
    assert keys() == (State.warning, "there is no API key in force")


def test_a_read_only_disk_is_one_failure_that_says_how_to_save_the_data(
    api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.statvfs

    def read_only(path: Any) -> os.statvfs_result:
        values = list(real(path))
        values[8] |= os.ST_RDONLY
        return os.statvfs_result(values)

    monkeypatch.setattr(os, "statvfs", read_only)
    results = [one for part in inspect_quickly(api.installation.settings).values() for one in part]
    (failure,) = [one for one in results if one.state is State.failed]
    assert "cp -a" in (failure.advice or "")
    assert not any("chown" in (one.advice or "") for one in results)


def test_a_full_disk_is_advised_what_keeps_the_data(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The floor is what leaves the room to delete, files removed by hand are lost, and the owner is not at fault."""

    def full(*_arguments: Any, **_options: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    settings = api.installation.settings.model_copy(update={"disk_floor_bytes": 268_435_456})
    usage = shutil.disk_usage(settings.data_dir)
    monkeypatch.setattr(tempfile, "NamedTemporaryFile", full)
    monkeypatch.setattr(shutil, "disk_usage", lambda _folder: usage._replace(free=0))
    failures = [one for one in data_folder.check(settings) if one.state is State.failed]
    assert [one.detail.partition(":")[0] for one in failures] == [
        "cannot be written",
        "0 MB free, below the minimum of 268 MB",
    ]
    for one in failures:
        assert one.advice is not None
        assert one.advice.startswith("Remove other files from that disk, or enlarge it")
        assert "by hand" in one.advice
        assert "chown" not in one.advice
        assert "GRIDPOSE_DISK_FLOOR_BYTES" not in one.advice
