"""A schema is changed only where nobody uses it: a program of the former version could not write the new one."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import typer

from app.cli.context import REFUSED
from app.cli.server.keys import Scope, create, show
from app.cli.server.serve import serve
from app.cli.server.worker import work
from app.errors import InstallationRefused
from app.main import create_app
from app.records import migrations
from app.records.database import Database
from app.records.file_lock import FileLock
from app.records.presence import RunnerLock
from app.services.installation.context import ServiceContext
from app.settings import Settings
from tests.support.environment.postgres import EITHER_DATABASE

FORMER = "0007"


@pytest.fixture(params=EITHER_DATABASE)
def former(request: pytest.FixtureRequest, tmp_path: Path) -> Settings:
    """Settings of an installation with the former schema."""
    url = request.getfixturevalue("postgres_url") if request.param == "postgresql" else None
    settings = Settings(data_dir=tmp_path / "data", workers=0, database_url=url)
    installation = ServiceContext.open(settings)
    migrations.downgrade(installation.database, FORMER)
    installation.close()
    return settings


@pytest.fixture
def kept_umask() -> Iterator[None]:
    """Take back what a command did to this process's umask."""
    before = os.umask(0o077)
    yield
    os.umask(before)


def revision(settings: Settings) -> str | None:
    database = Database(settings.effective_database_url)
    try:
        return migrations.current_revision(database)
    finally:
        database.dispose()


def code(settings: Settings, **how: bool) -> str:
    with pytest.raises(InstallationRefused) as caught:
        ServiceContext.open(settings, **how)
    return caught.value.code


@pytest.mark.parametrize("name", ["head.lock", "runner.lock"])
def test_a_newer_program_leaves_the_schema_of_a_running_one(former: Settings, name: str) -> None:
    with FileLock(former.data_dir / name):
        assert code(former) == "service_running"
    assert revision(former) == FORMER
    assert not (former.data_dir / "backups").exists()
    ServiceContext.open(former).close()
    assert revision(former) == migrations.head_revision()


@pytest.mark.postgres
def test_a_worker_with_another_folder_is_seen_in_the_database(postgres_url: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path / "data", workers=0, database_url=postgres_url)
    ServiceContext.open(settings).close()
    database = Database(postgres_url)
    migrations.downgrade(database, FORMER)
    (tmp_path / "elsewhere").mkdir()
    lock = RunnerLock(tmp_path / "elsewhere", database)
    lock.acquire()
    assert code(settings) == "service_running"
    lock.release()
    database.dispose()
    assert revision(settings) == FORMER


def test_a_service_that_holds_its_own_lock_brings_the_schema_up(former: Settings) -> None:
    from fastapi.testclient import TestClient

    with TestClient(create_app(former)):
        assert revision(former) == migrations.head_revision()


@pytest.mark.parametrize("name", ["head.lock", "runner.lock"])
def test_serve_and_worker_end_before_they_change_anything(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    kept_umask: None,
    name: str,
) -> None:
    settings = Settings(data_dir=tmp_path / "data", workers=0)
    installation = ServiceContext.open(settings)
    migrations.downgrade(installation.database, FORMER)
    installation.close()
    monkeypatch.setenv("GRIDPOSE_WORKERS", "1")
    for module in ("serve", "worker"):
        monkeypatch.setattr(f"app.cli.server.{module}.configure_logging", lambda _: None)
    monkeypatch.setattr("app.cli.server.serve.listen", lambda _: None)
    commands: list[Callable[[], int]] = [lambda: serve(None, 0, settings.data_dir, False)]
    commands += [lambda: work(settings.data_dir)]
    with FileLock(settings.data_dir / name):
        for command in commands:
            with pytest.raises(typer.Exit) as ended:
                command()
            assert ended.value.exit_code in (1, REFUSED)
            assert str(settings.data_dir) in capsys.readouterr().err
    assert revision(settings) == FORMER


def test_other_commands_change_no_schema(
    tmp_path: Path, kept_umask: None, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "data"
    assert create("k", Scope.admin, data_dir=folder, init=True) == 0, "the first one makes an installation"
    database = Database(f"sqlite:///{folder / 'gridpose.sqlite3'}")
    migrations.downgrade(database, FORMER)
    database.dispose()
    settings = Settings(data_dir=folder, workers=0)
    commands: list[Callable[[], int]] = [
        lambda: show(folder),
        lambda: create("k", Scope.admin, data_dir=folder),
        lambda: create("k", Scope.admin, data_dir=folder, init=True),
    ]
    for command in commands:
        with pytest.raises(typer.Exit) as ended:
            command()
        assert ended.value.exit_code == REFUSED
        assert "gridpose serve" in capsys.readouterr().err
    assert revision(settings) == FORMER
    assert not (folder / "backups").exists()
