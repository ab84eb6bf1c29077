"""What the database itself enforces, and that it loses nothing."""

from __future__ import annotations

import sqlite3
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Timer

import pytest
import sqlalchemy as sa

from app.records import migrations
from app.records.database import Database, sqlite_driver
from app.records.ids import new_id
from app.records.tables import (
    AuditEntry,
    Installation,
    Measurement,
)
from tests.support.records.filled_tables import NOW, fill
from tests.support.service.backups import content


def test_audit_entries_cannot_be_changed_or_deleted(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    with database.write() as records:
        records.add(AuditEntry(id=new_id("aud"), at=NOW, actor="cli", action="create_key", object_ids=["x"]))
    before = content(database)["audit_entries"]
    assert len(before) == 1
    statements = ["UPDATE audit_entries SET actor = 'key'", "DELETE FROM audit_entries"]
    if not database.is_sqlite:
        statements.append("TRUNCATE audit_entries")
    for statement in statements:
        with (
            pytest.raises(sa.exc.DatabaseError, match="never changed or deleted"),
            database.write() as records,
        ):
            records.execute(sa.text(statement))
    assert content(database)["audit_entries"] == before


def test_an_installation_is_one(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    with database.write() as records:
        records.add(Installation(id=new_id("ins"), created_at=NOW))
    for number in (1, 2):
        with pytest.raises(sa.exc.IntegrityError), database.write() as records:
            records.execute(sa.insert(Installation).values(number=number, id=new_id("ins"), created_at=NOW))


def test_the_database_enforces_what_the_tables_say(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    rows = fill(database)
    session_id, pose_id = rows["measurements"][0]["session_id"], new_id("pos")
    for statement in (
        "UPDATE measurements SET status = 'lost'",
        "UPDATE api_keys SET scope = 'root'",
        "UPDATE measurements SET pose_id = 'other'",
        f"INSERT INTO poses (id, session_id, pose_id) VALUES ('{pose_id}', '{session_id}', 'P1')",
        f"INSERT INTO poses (id, session_id, pose_id) VALUES ('{pose_id}', 'nobody', 'P2')",
        "DELETE FROM targets",
    ):
        with pytest.raises(sa.exc.IntegrityError), database.write() as records:
            records.execute(sa.text(statement))
    with database.write() as records:
        records.execute(sa.text("DELETE FROM sessions"))
    left = content(database)
    assert [name for name, kept in left.items() if not kept] != []
    assert left["measurements"] == left["results"] == left["poses"] == left["session_targets"] == []
    assert left["measured_poses"] == []
    assert len(left["targets"]) == len(left["robots"]) == len(left["api_keys"]) == 1


def test_sqlite_is_set_up_to_lose_nothing(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'x.sqlite3'}")
    for engine in (database._writer, database._reader):
        with engine.connect() as connection:
            pragmas = {
                name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
                for name in ("journal_mode", "synchronous", "foreign_keys")
            }
        assert pragmas == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}
    database.dispose()
    module, bundled = sqlite_driver()
    assert bundled == (module is not sqlite3)


def test_a_new_file_that_another_process_writes_is_waited_for(tmp_path: Path) -> None:
    """Two first starts at once: one of them failed, since SQLite refuses to change the mode without waiting."""
    path = tmp_path / "x.sqlite3"
    module, _ = sqlite_driver()
    other = module.connect(path, isolation_level=None, check_same_thread=False)
    for statement in ("CREATE TABLE t (a)", "BEGIN IMMEDIATE", "INSERT INTO t VALUES (1)"):
        other.execute(statement)
    commit = Timer(0.3, other.execute, ["COMMIT"])
    commit.start()
    database = Database(f"sqlite:///{path}")
    with database.engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar() == "wal"
    database.dispose()
    commit.join()
    other.close()


def test_concurrent_increments_are_all_kept(database: Database, tmp_path: Path) -> None:
    """The loss that BEGIN IMMEDIATE prevents: read, then write, from several threads and engines at once."""
    migrations.upgrade(database, tmp_path)
    fill(database)
    others = [Database(database.url.render_as_string(hide_password=False)) for _ in range(4)]

    def increment(other: Database) -> None:
        for _ in range(25):
            with other.write() as records:
                row = records.scalars(sa.select(Measurement).with_for_update()).one()
                row.attempts = row.attempts + 1

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(increment, others))
    for other in others:
        other.dispose()
    assert content(database)["measurements"][0]["attempts"] == 101
