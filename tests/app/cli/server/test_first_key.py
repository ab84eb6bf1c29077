"""The first admin key, the modes of the data folder, keys on the command line, and what doctor says of them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from app.cli.server.first_key import announce_admin_key, ensure_admin_key
from app.client.commands import KeyFile, UploadKey
from app.errors import Unavailable
from app.records.audit import list_entries
from app.records.privacy import close_to_others, exposed
from app.services import keys
from app.services.first_key import FIRST_KEY_FILE
from app.services.inspection import data_folder
from app.services.inspection.check_result import State
from app.services.installation.context import ServiceContext
from app.services.keys import find_key, list_keys, revoke_key
from app.settings import Settings

posix = pytest.mark.skipif(os.name != "posix", reason="modes of files are POSIX's")


@pytest.fixture
def installation(tmp_path: Path) -> Any:
    opened = ServiceContext.open(Settings(data_dir=tmp_path / "data", workers=0))
    yield opened
    opened.close()


def admins(installation: ServiceContext) -> int:
    return sum(key.scope == "admin" for key in list_keys(installation)[0])


def test_stdout_that_is_no_terminal_holds_no_key(
    installation: ServiceContext, capsys: pytest.CaptureFixture[str]
) -> None:
    path = ensure_admin_key(installation)
    assert path is not None
    announce_admin_key(path)
    printed = capsys.readouterr().out
    key = path.read_text().strip()
    assert str(path) in printed
    assert key not in printed
    assert key.rpartition("_")[2] not in printed
    found = find_key(installation, key)
    assert found is not None
    assert (found.scope, found.made_by) == ("admin", "cli")
    if os.name == "posix":
        assert path.stat().st_mode & 0o777 == 0o600
    with installation.database.read() as records:
        (entry,) = list_entries(records, limit=10, cursor=None)[0]
    assert (entry.actor, entry.action, entry.object_ids) == ("cli", "create_key", [found.id])


def test_a_terminal_shows_the_key_and_the_file_goes(
    installation: ServiceContext, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = ensure_admin_key(installation)
    assert path is not None
    key = path.read_text().strip()
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    announce_admin_key(path)
    assert key in capsys.readouterr().out
    assert not path.exists()
    assert ensure_admin_key(installation) is None
    assert admins(installation) == 1


def test_a_crash_between_file_and_database_locks_nobody_out(
    installation: ServiceContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    def crash(*_: Any) -> None:
        raise Unavailable("as if the power went")

    with monkeypatch.context() as patched:
        patched.setattr("app.cli.server.first_key.store_key", crash)
        with pytest.raises(Unavailable):
            ensure_admin_key(installation)
    stale = (installation.settings.data_dir / FIRST_KEY_FILE).read_text()
    assert admins(installation) == 0
    path = ensure_admin_key(installation)
    assert path is not None
    assert path.read_text() != stale
    assert find_key(installation, path.read_text().strip()) is not None
    # And a crash after the key is in force: the next start finds its file.
    assert ensure_admin_key(installation) == path
    assert admins(installation) == 1


def test_a_file_whose_key_is_revoked_goes(installation: ServiceContext) -> None:
    path = ensure_admin_key(installation)
    assert path is not None
    key = find_key(installation, path.read_text().strip())
    assert key is not None
    revoke_key(installation, key.id)
    assert ensure_admin_key(installation) is None
    assert not path.exists()


def test_a_service_without_keys_makes_none(tmp_path: Path) -> None:
    opened = ServiceContext.open(Settings(data_dir=tmp_path / "data", workers=0, auth="off"))
    assert ensure_admin_key(opened) is None
    assert keys.list_keys(opened)[0] == []
    opened.close()


@posix
def test_a_folder_made_beforehand_is_closed_to_others(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir(mode=0o755)
    folder.chmod(0o755)
    settings = Settings(data_dir=folder, workers=0)
    ServiceContext.open(settings).close()
    assert folder.stat().st_mode & 0o777 == 0o700
    for name in ("gridpose.sqlite3", "key-pepper"):
        (folder / name).chmod(0o644)
    assert {path.name for path in exposed(folder)} == {"gridpose.sqlite3", "key-pepper"}
    ServiceContext.open(settings).close()
    assert exposed(folder) == []


@posix
def test_doctor_finds_what_others_can_read(installation: ServiceContext) -> None:
    folder = installation.settings.data_dir
    ensure_admin_key(installation)
    close_to_others(folder)  # this process has another umask than the service

    def warnings(**settings: Any) -> list[str]:
        changed = installation.settings.model_copy(update={"disk_floor_bytes": 0, **settings})
        return [
            f"{finding.detail} {finding.advice}"
            for finding in data_folder.check(changed)
            if finding.state is State.warning and not finding.detail.startswith(("can be written", "is on a"))
        ]

    (still_there,) = warnings()
    assert FIRST_KEY_FILE in still_there
    (folder / FIRST_KEY_FILE).unlink()
    assert warnings() == []
    assert "plain HTTP" in warnings(host="0.0.0.0")[0]
    for name in ("gridpose.sqlite3", "key-pepper", "."):
        (folder / name).chmod(0o755)
        (warning,) = warnings()
        assert "chmod" in warning
        (folder / name).chmod(0o700)


def command() -> typer.Typer:
    app = typer.Typer()

    @app.command()
    def run(key: UploadKey = None, key_file: KeyFile = None) -> None:
        typer.echo(f"key={key} file={key_file is not None}")

    return app


def test_a_key_comes_from_a_file_the_environment_or_the_command_line(tmp_path: Path) -> None:
    file = tmp_path / "key"
    file.write_text("gp_file\n")
    runner, app = CliRunner(), command()

    def chosen(*arguments: str, **environment: str) -> str:
        ended = runner.invoke(app, list(arguments), env=environment)
        assert ended.exit_code == 0, ended.output
        return ended.output.split()[0]

    assert chosen() == "key=None"
    assert chosen(GRIDPOSE_KEY="gp_env") == "key=gp_env"
    assert chosen("--api-key", "gp_arg", GRIDPOSE_KEY="gp_env") == "key=gp_arg"
    assert chosen("--api-key-file", str(file), GRIDPOSE_KEY="gp_env") == "key=gp_file"
    assert chosen(GRIDPOSE_KEY="gp_env", GRIDPOSE_KEY_FILE=str(file)) == "key=gp_file"
    assert "command line" in runner.invoke(app, ["--help"], env={"COLUMNS": "200"}).output


@pytest.mark.parametrize("content", [None, b"", b"gp_a gp_b", b"\xff\xfe"])
def test_a_key_file_that_holds_no_key_is_refused(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "key"
    if content is not None:
        file.write_bytes(content)
    ended = CliRunner().invoke(command(), ["--api-key-file", str(file)])
    assert ended.exit_code == 2
    assert "key" in ended.output
