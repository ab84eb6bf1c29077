"""`gridpose doctor --deep`: every original hashed, rows and files compared, the database read whole."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.cli.doctor.command import doctor as run_doctor
from app.records.database import Database
from app.services.inspection.database import check_deep
from app.services.maintenance.orphans import GRACE_S
from tests.support.image.images import flip_bit


@pytest.fixture
def doctor(
    any_api: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[[], tuple[int, str]]:
    """Return a function that examines the running service's folder and returns the exit code and what was printed."""
    settings = any_api.installation.settings
    if settings.database_url is not None:
        monkeypatch.setenv("GRIDPOSE_DATABASE_URL", settings.database_url)
    monkeypatch.setenv("GRIDPOSE_DISK_FLOOR_BYTES", "0")

    def run() -> tuple[int, str]:
        capsys.readouterr()
        return run_doctor(settings.data_dir, deep=True), capsys.readouterr().out

    return run


def test_damage_is_named_with_the_measurements_it_concerns(
    any_api: Any, grey_png: bytes, doctor: Callable[[], tuple[int, str]]
) -> None:
    session_id = any_api.make_session()
    sound, corrupt, short, gone = (
        any_api.put_image(session_id, grey_png + b"%d" % number, filename=f"{number}.png").json()
        for number in range(4)
    )
    code, said = doctor()
    assert code == 0, said
    assert "4 files" in said
    assert "4 have the SHA-256 of their names" in said
    assert "what it refers to is there" in said

    blobs = any_api.installation.blobs
    flip_bit(blobs.path(corrupt["sha256"]))
    os.truncate(blobs.path(short["sha256"]), 3)
    blobs.path(gone["sha256"]).unlink()
    code, said = doctor()
    assert code == 1
    lines = [line for line in said.splitlines() if "FAIL" in line]
    found = {name: line for line in lines for name in ("is corrupt", "is missing") if name in line}
    assert len(lines) == 3
    assert set(found) == {"is corrupt", "is missing"}
    assert gone["id"] in found["is missing"]
    assert session_id in found["is missing"]
    assert "3.png" in found["is missing"]
    for measurement in (corrupt, short):
        (line,) = [line for line in lines if measurement["sha256"] in line]
        assert "is corrupt" in line
        assert measurement["id"] in line
    assert sound["sha256"] not in said
    assert "gridpose upload" in said

    # What it says to do mends everything.
    for measurement in (corrupt, short):
        blobs.path(measurement["sha256"]).unlink()
    for number in (1, 2, 3):
        assert any_api.put_image(session_id, grey_png + b"%d" % number).status_code == 200
    assert doctor()[0] == 0


def test_orphans_are_the_services_own_affair_for_a_day_or_two(
    any_api: Any, doctor: Callable[[], tuple[int, str]]
) -> None:
    path: Path = any_api.installation.blobs.path("a" * 64)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"nobody's")
    code, said = doctor()
    assert "warn" in said
    assert f"aa/{'a' * 64} is corrupt" in said
    assert code == 1
    path.unlink()
    data = b"nobody's"
    name = hashlib.sha256(data).hexdigest()
    path = any_api.installation.blobs.path(name)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)
    code, said = doctor()
    assert (code, "1 files" in said) == (0, True), said
    then_s = time.time() - 3 * GRACE_S
    os.utime(path, (then_s, then_s))
    code, said = doctor()
    assert code == 1
    assert f"{name} is orphaned" in said


def test_rows_that_refer_to_nothing_are_found(
    any_api: Any, grey_png: bytes, doctor: Callable[[], tuple[int, str]]
) -> None:
    any_api.put_image(any_api.make_session(), grey_png)
    database: Database = any_api.installation.database
    if database.is_sqlite:
        with database.engine.connect() as connection:
            driver: Any = connection.connection.driver_connection
            driver.rollback()
            driver.execute("PRAGMA foreign_keys=OFF")
            driver.execute("DELETE FROM targets")
            driver.execute("PRAGMA foreign_keys=ON")
    else:
        with database.write() as records:
            records.execute(sa.text("ALTER TABLE measurements DISABLE TRIGGER ALL"))
            records.execute(sa.text("ALTER TABLE targets DISABLE TRIGGER ALL"))
            records.execute(sa.text("DELETE FROM targets"))
    code, said = doctor()
    assert code == 1
    assert "rows of measurements refer to nothing in targets" in said
    assert "rows of session_targets refer to nothing in targets" in said
    assert "gridpose restore" in said


def test_damage_within_the_database_is_found(api: Any, grey_png: bytes, tmp_path: Path) -> None:
    """An index that lacks a row: every page is readable, so that a quick look finds nothing."""
    api.put_image(api.make_session(), grey_png)
    database: Database = api.installation.database
    with database.engine.connect() as connection:
        driver: Any = connection.connection.driver_connection
        driver.rollback()
        driver.execute("PRAGMA writable_schema=ON")
        driver.execute(
            "UPDATE sqlite_schema SET sql = replace(sql, 'ON measurements (sha256)', 'ON measurements (filename)') "
            "WHERE name = 'ix_measurements_sha256'"
        )
        driver.execute("PRAGMA writable_schema=RESET")
        driver.execute("PRAGMA writable_schema=OFF")
    copy = Database(database.url.render_as_string(hide_password=False))
    with copy.read() as records:
        said = [result.detail for result in check_deep(copy, records, "")]
    copy.dispose()
    assert any("is damaged" in what and "ix_measurements_sha256" in what for what in said)
