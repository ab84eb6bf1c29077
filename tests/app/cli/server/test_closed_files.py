"""Files that are closed to the service's user: named by doctor and by the commands, which go on where they can.

Root may use every file, so that the system's calls are replaced; none of our own code is.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer

from app.cli.context import data_failures
from app.cli.doctor.command import doctor
from app.cli.server.first_key import ensure_admin_key
from app.services.first_key import FIRST_KEY_FILE
from app.services.inspection import State, data_folder, files
from app.services.installation.context import ServiceContext
from app.services.keys import find_key, revoke_key
from app.settings import Settings, unknown_settings


@pytest.fixture
def folder(empty_data_dir: Path, tmp_path: Path) -> Path:
    """The data folder of an installation whose service is not running."""
    ServiceContext.open(Settings(data_dir=tmp_path / "data", workers=0)).close()
    return tmp_path / "data"


def closing(call: Callable[..., Any], *closed: Path) -> Callable[..., Any]:
    """Return a call that refuses these paths, which it has as its first argument."""

    def refuse(path: Any, *arguments: Any, **options: Any) -> Any:
        if not isinstance(path, int) and Path(path) in closed:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return call(path, *arguments, **options)

    return refuse


@pytest.mark.parametrize("name", ["key-pepper", "installation.json"])
def test_doctor_names_a_file_that_it_may_not_read_and_goes_on(
    folder: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    installation = ServiceContext.open(Settings(data_dir=folder, workers=0))
    ensure_admin_key(installation)  # with keys in force the pepper is looked at
    installation.close()
    monkeypatch.setattr("io.open", closing(open, folder / name))
    assert doctor(folder) == 1
    said = capsys.readouterr().out
    assert any("FAIL" in line and str(folder / name) in line for line in said.splitlines())
    assert "is intact" in said


def test_doctor_deep_names_a_folder_of_originals_that_it_may_not_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(os, "scandir", closing(os.scandir, folder / "originals" / "00"))
    assert doctor(folder, deep=True) == 1
    said = capsys.readouterr().out
    assert any("FAIL" in line and str(folder / "originals" / "00") in line for line in said.splitlines())


@pytest.mark.parametrize("name", ["head.lock", "runner.lock", "migrate.lock", "originals", FIRST_KEY_FILE])
def test_what_keeps_the_service_from_starting_is_a_failure(
    folder: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name != "originals":
        (folder / name).touch()
    assert [one.state for one in files.check(folder)] == [State.ok]
    may = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != folder / name and may(path, mode))
    (found,) = files.check(folder)
    assert found.state is State.failed
    assert str(folder / name) in found.detail


def test_a_command_names_the_file_that_it_may_not_use(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit), data_failures(Settings(data_dir=folder)):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(folder / "runner.lock"))
    assert str(folder / "runner.lock") in "".join(capsys.readouterr().err.splitlines())


def test_a_first_key_that_cannot_be_read_does_not_keep_the_service_from_starting(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installation = ServiceContext.open(Settings(data_dir=folder, workers=0))
    path = ensure_admin_key(installation)
    assert path == folder / FIRST_KEY_FILE
    with monkeypatch.context() as patched:
        patched.setattr("io.open", closing(open, path))
        assert ensure_admin_key(installation) is None
    assert path.exists()
    installation.close()


def test_a_first_key_that_is_revoked_is_not_to_be_stored(folder: Path) -> None:
    installation = ServiceContext.open(Settings(data_dir=folder, workers=0))
    path = ensure_admin_key(installation)
    assert path is not None
    key = find_key(installation, path.read_text().strip())
    assert key is not None
    content = path.read_text()
    revoke_key(installation, key.id)
    assert not path.exists()
    path.write_text(content)  # as an earlier version left it
    path.chmod(0o600)
    installation.close()
    (found,) = [
        one for one in data_folder.check(Settings(data_dir=folder)) if one.detail.startswith(FIRST_KEY_FILE)
    ]
    assert found.advice == f"Remove {path}"


def test_settings_that_nothing_reads_are_found_with_what_is_like_them() -> None:
    environment = {
        "GRIDPOSE_WORKER": "4",
        "GRIDPOSE_RETENTION_DAY": "30",
        "GRIDPOSE_FROBNICATE": "1",
        "GRIDPOSE_WORKERS": "2",
        "gridpose_port": "1",
        "GRIDPOSE_URL": "http://localhost",
        "GRIDPOSE_TEST_DATA": "x",
        "HOME": "/",
    }
    assert unknown_settings(environment) == [
        ("GRIDPOSE_FROBNICATE", None),
        ("GRIDPOSE_RETENTION_DAY", "GRIDPOSE_RETENTION_DAYS"),
        ("GRIDPOSE_WORKER", "GRIDPOSE_WORKERS"),
    ]


def test_a_start_on_a_full_disk_says_so(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    usage = shutil.disk_usage(folder)
    monkeypatch.setattr(shutil, "disk_usage", lambda _path: usage._replace(free=4096))
    with pytest.raises(typer.Exit), data_failures(Settings(data_dir=folder)):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert "4096" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("inside", "number", "said"),
    [
        (False, errno.EACCES, "chown -R"),
        (True, errno.EACCES, "mounted, writable and has room"),
        (False, errno.EROFS, "chown -R"),
        (True, errno.EROFS, "chown -R"),
    ],
)
def test_a_file_elsewhere_and_a_read_only_disk_are_not_blamed_on_the_owner_of_the_data_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], inside: bool, number: int, said: str
) -> None:
    place = (tmp_path / "data" if inside else tmp_path) / "file"
    with pytest.raises(typer.Exit), data_failures(Settings(data_dir=tmp_path / "data", workers=0)):
        raise OSError(number, os.strerror(number), str(place))
    assert said not in capsys.readouterr().err
