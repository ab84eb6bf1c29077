"""A damaged database: what is said of it, what goes on, and what a backup and a start answer."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import pytest
import typer

from app.cli.context import data_failures
from app.errors import Unavailable
from app.logs import Sparingly
from app.records import migrations
from app.records.database import Database, map_database_errors, sqlite_driver
from app.services.backup import damage_advice, make_backup
from app.services.backup.latest import FILE_NAME
from app.services.health import check_storage
from app.services.inspection import State, database
from app.services.installation.context import ServiceContext
from app.settings import Settings
from tests.support.service.backups import refused


@pytest.fixture
def damaged(empty_data_dir: Path, tmp_path: Path) -> Settings:
    """A data folder whose database has lost all pages but the first."""
    settings = Settings(data_dir=tmp_path / "damaged", workers=0)
    ServiceContext.open(settings).close()
    with (settings.data_dir / "gridpose.sqlite3").open("r+b") as file:
        size = file.seek(0, 2)
        file.seek(4096)
        file.write(b"\xff" * (size - 4096))
    return settings


def test_a_damaged_database_is_restored_from_the_backup_that_is_noted(damaged: Settings) -> None:
    (failed,) = [one for one in database.check(damaged) if one.state is State.failed]
    assert failed.advice == damage_advice(damaged)
    assert "gridpose restore LAST_BACKUP" in failed.advice
    assert "backups" not in failed.advice
    (damaged.data_dir / FILE_NAME).write_text(
        json.dumps({"created_at": "2026-01-02T03:04:05+00:00", "folder": "/mnt/copy", "lacking": 0})
    )
    (damaged.data_dir / "backups").mkdir()
    (damaged.data_dir / "backups" / "gridpose-0026-20250101T000000.000000Z.sqlite3").touch()
    advice = damage_advice(damaged)
    assert advice.index("gridpose restore /mnt/copy") < advice.index("gridpose-0026")


def test_a_command_on_a_damaged_database_is_refused_in_a_sentence(damaged: Settings, tmp_path: Path) -> None:
    with pytest.raises(typer.Exit) as ended, data_failures(damaged):
        ServiceContext.open(damaged)
    assert ended.value.exit_code == 2
    copied = Database(damaged.effective_database_url)
    with pytest.raises(Unavailable) as error:
        migrations.copy_to_file(copied, tmp_path / "copy.sqlite3")
    copied.dispose()
    assert error.value.code == "database_damaged"
    assert copied.damage.seen


def test_a_backup_of_a_damaged_database_is_refused(
    api: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_arguments: Any) -> None:
        with map_database_errors(api.installation.database.damage):
            raise sqlite_driver()[0].DatabaseError("database disk image is malformed")

    monkeypatch.setattr(migrations, "copy_to_file", fail)
    assert refused(lambda: make_backup(api.installation, tmp_path / "copy")) == "database_damaged"
    assert [one.name for one in check_storage(api.installation) if not one.ok] == ["database"]


def test_a_backup_folder_that_cannot_be_used_is_no_broken_data_folder(
    api: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside = api.installation.settings.data_dir / "copy"
    assert refused(lambda: make_backup(api.installation, inside)) == "backup_in_data_folder"
    assert not inside.exists()
    make_directory = Path.mkdir

    def refuse(path: Path, *arguments: Any, **options: Any) -> None:
        if path == tmp_path / "copy":
            raise OSError(errno.EROFS, "Read-only file system", str(path))
        make_directory(path, *arguments, **options)

    monkeypatch.setattr(Path, "mkdir", refuse)
    assert refused(lambda: make_backup(api.installation, tmp_path / "copy")) == "backup_folder_unusable"


def test_what_happens_every_second_is_logged_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("app.logs.time.monotonic", lambda: now)
    may = Sparingly()
    assert may.due("full")
    now += 59.0
    assert not may.due("full")
    assert may.due("locked")
    now += 2.0
    assert may.due("full")
