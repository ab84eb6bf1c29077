"""The schema's ways up and down, with data in it, on both databases."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.script import ScriptDirectory

from app.records import schema
from app.records.database import Database, sqlite_driver
from app.records.ids import new_id
from app.records.tables import (
    ApiKey,
    MeasuredPose,
    Measurement,
    Pose,
    Result,
    Robot,
    Session,
    SessionTarget,
    Table,
    Target,
    target_fields,
)

SINCE_THE_FIRST = ("measured_poses",)
NOW = datetime(2026, 1, 31, 12, 0, 0, 123456, tzinfo=UTC)


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """An empty database of either kind."""
    url = f"sqlite:///{tmp_path / 'x.sqlite3'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("postgres_url")
    database = Database(url)
    yield database
    database.dispose()


def fill(database: Database) -> dict[str, list[dict[str, Any]]]:
    """Put a row into every table and return what each then holds."""
    session_id, target_id, robot_id, measurement_id = (new_id(p) for p in ("ses", "tgt", "rob", "mea"))
    with database.write() as records:
        records.add(ApiKey(id=new_id("key"), name="k", scope="read", secret_hmac="0" * 64, created_at=NOW))
        records.add(
            Target(
                id=target_id,
                name="ø",
                kind="chessboard",
                columns=9,
                rows=6,
                pitch_mm=0.1,
                legacy_layout=True,
                created_at=NOW,
            )
        )
        records.add(Robot(id=robot_id, name="r", joints=[{"a_mm": 1.5}], created_at=NOW))
        records.flush()
        records.add(
            Session(id=session_id, name="s", robot_id=robot_id, lens={"focal_length_mm": 8.0}, created_at=NOW)
        )
        records.flush()
        records.add(SessionTarget(session_id=session_id, position=0, target_id=target_id))
        records.add(Pose(id=new_id("pos"), session_id=session_id, pose_id="P1", position_mm=[1, 2, 3]))
        records.flush()
        records.add(
            MeasuredPose(
                id=new_id("mpo"),
                session_id=session_id,
                pose_id="P1",
                position_mm=[0.1, 2.0, 3.0],
                content_sha256="0" * 64,
            )
        )
        records.add(
            Measurement(
                id=measurement_id,
                session_id=session_id,
                pose_id="P1",
                target_id=target_id,
                seeks_target=True,
                focus_group="default",
                received_at=NOW,
                sha256="0" * 64,
                bytes=2**40,
                image_format="png",
                image_width_px=1,
                image_height_px=1,
                status="succeeded",
                attempts=1,
            )
        )
        records.flush()
        records.add(
            Result(
                measurement_id=measurement_id,
                estimator="per_image",
                calibration={"f": 0.1 + 0.2},
                state=bytes(range(256)),
                points=b"\0\1",
                core_version="1",
                settings={},
                input_sha256="0" * 64,
            )
        )
    return content(database)


def content(database: Database) -> dict[str, list[dict[str, Any]]]:
    with database.read() as records:
        return {
            table.name: [
                dict(row._mapping) for row in records.execute(sa.select(table).order_by(*table.primary_key))
            ]
            for table in Table.metadata.sorted_tables
        }


def revisions() -> list[str]:
    """Every revision, first to last."""
    scripts = ScriptDirectory.from_config(schema.migration_config())
    return [script.revision for script in reversed(list(scripts.walk_revisions()))]


def test_the_way_up_ends_at_the_tables_the_program_uses(database: Database, tmp_path: Path) -> None:
    schema.upgrade(database, tmp_path)
    assert schema.current_revision(database) == schema.head_revision()
    with database.engine.connect() as connection, connection.begin():
        command.check(schema.migration_config(connection))


def test_every_step_up_and_down_keeps_the_data_it_can(database: Database, tmp_path: Path) -> None:
    schema.upgrade(database, tmp_path)
    before = fill(database)
    assert all(len(rows) == 1 for rows in before.values())
    known = revisions()
    # Down to the first revision and up again: what the first tables hold survives every later change.
    schema.downgrade(database, known[0])
    schema.upgrade(database, tmp_path)
    lost: dict[str, list[dict[str, Any]]] = {table: [] for table in SINCE_THE_FIRST}
    assert content(database) == {**before, **lost}


def test_markers_come_and_go_and_leave_the_result_as_it_was(database: Database, tmp_path: Path) -> None:
    schema.upgrade(database, tmp_path)
    before = fill(database)
    with database.write() as records:
        records.execute(sa.update(Result).values(markers=bytes(range(68))))
    assert content(database)["results"][0]["markers"] == bytes(range(68))
    schema.downgrade(database, "0002")
    assert "markers" not in {column["name"] for column in sa.inspect(database.engine).get_columns("results")}
    schema.upgrade(database, tmp_path)
    assert content(database) == before


def test_images_of_sessions_with_one_target_named_none(database: Database, tmp_path: Path) -> None:
    """To send such an image again without naming the target must find it, however many targets the session has now."""
    schema.upgrade(database, tmp_path)
    before = fill(database)
    second = new_id("tgt")
    with database.write() as records:
        (target,) = records.scalars(sa.select(Target)).all()
        records.add(Target(id=second, **{**target_fields(target), "columns": 5}, name="b", created_at=NOW))
        (one,) = records.scalars(sa.select(Session)).all()
        both = Session(id=new_id("ses"), name="both", created_at=NOW)
        records.add(both)
        records.flush()
        both.targets.extend(
            SessionTarget(position=k, target_id=target_id) for k, target_id in enumerate((target.id, second))
        )
        records.add(Pose(id=new_id("pos"), session_id=both.id, pose_id="P1"))
        records.flush()
        fields = {**before["measurements"][0], "session_id": both.id, "seeks_target": False}
        records.add(Measurement(**{**fields, "id": new_id("mea")}))
        records.add(Measurement(**{**fields, "id": new_id("mea"), "target_id": second}))
    before = content(database)
    schema.downgrade(database, "0003")
    schema.upgrade(database, tmp_path)
    assert content(database) == before
    seeking = {row["session_id"]: row["seeks_target"] for row in content(database)["measurements"]}
    assert seeking == {one.id: True, both.id: False}


def test_only_what_shows_no_target_is_lost_on_the_way_down(database: Database, tmp_path: Path) -> None:
    schema.upgrade(database, tmp_path)
    before = fill(database)
    with database.write() as records:
        row = {
            **before["measurements"][0],
            "id": new_id("mea"),
            "sha256": "1" * 64,
            "target_id": None,
            "status": "failed",
        }
        records.add(Measurement(**row))
        records.flush()
        records.add(Result(**{**before["results"][0], "measurement_id": row["id"]}))
    assert len(content(database)["results"]) == 2
    schema.downgrade(database, "0003")
    schema.upgrade(database, tmp_path)
    assert content(database) == before


def test_one_image_is_searched_for_targets_once(database: Database, tmp_path: Path) -> None:
    schema.upgrade(database, tmp_path)
    row = {**fill(database)["measurements"][0], "target_id": None}
    with pytest.raises(sa.exc.IntegrityError), database.write() as records:
        records.add(Measurement(**{**row, "id": new_id("mea")}))
    with database.write() as records:
        for _ in range(2):  # without seeking, targets that are not known do not hinder one another
            records.add(Measurement(**{**row, "id": new_id("mea"), "seeks_target": False}))


def test_origin_and_capture_quality_come_and_go(database: Database, tmp_path: Path) -> None:
    schema.upgrade(database, tmp_path)
    before = fill(database)
    quality = {"tilt": 0.1 + 0.2, "advice": []}
    with database.write() as records:
        records.execute(sa.update(Result).values(origin="turned", capture_quality=quality))
    assert content(database)["results"][0]["capture_quality"] == quality
    schema.downgrade(database, "0003")
    names = {column["name"] for column in sa.inspect(database.engine).get_columns("results")}
    assert not names & {"origin", "capture_quality"}
    schema.upgrade(database, tmp_path)
    assert content(database) == before


def test_the_way_down_ends_at_nothing(database: Database, tmp_path: Path) -> None:
    schema.upgrade(database, tmp_path)
    fill(database)
    schema.downgrade(database, "base")
    assert schema.current_revision(database) is None
    assert set(sa.inspect(database.engine).get_table_names()) <= {"alembic_version"}
    schema.upgrade(database, tmp_path)
    assert all(rows == [] for rows in content(database).values())


def test_several_processes_may_upgrade_at_once(database: Database, tmp_path: Path) -> None:
    others = [Database(database.url.render_as_string(hide_password=False)) for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda other: schema.upgrade(other, tmp_path), others))
    for other in others:
        other.dispose()
    assert schema.current_revision(database) == schema.head_revision()


def test_a_schema_from_the_future_is_left_alone(database: Database, tmp_path: Path) -> None:
    schema.upgrade(database, tmp_path)
    with database.write() as records:
        records.execute(sa.text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(schema.SchemaTooNew):
        schema.upgrade(database, tmp_path)


def test_the_database_enforces_what_the_tables_say(database: Database, tmp_path: Path) -> None:
    schema.upgrade(database, tmp_path)
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


def test_an_existing_sqlite_database_is_copied_before_it_is_changed(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'x.sqlite3'}")
    schema.upgrade(database, tmp_path)
    before = fill(database)
    backup = schema.back_up(database, tmp_path / "backups", "0001")
    database.dispose()
    copied = Database(f"sqlite:///{backup}")
    assert content(copied) == before
    copied.dispose()


def test_an_upgrade_backs_up_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later revision, made here, is applied to a database with data in it."""
    package = tmp_path / "later" / "migrations"
    shutil.copytree(Path(schema.migration_config().get_main_option("script_location") or ""), package)
    head = schema.head_revision()
    (package / "versions" / "later.py").write_text(
        f"""
import sqlalchemy as sa
from alembic import op
revision, down_revision, branch_labels, depends_on = "later", "{head}", None, None
def upgrade():
    with op.batch_alter_table("sessions", recreate="always") as batch:
        batch.add_column(sa.Column("note", sa.Text(), nullable=True))
def downgrade():
    with op.batch_alter_table("sessions", recreate="always") as batch:
        batch.drop_column("note")
"""
    )
    database = Database(f"sqlite:///{tmp_path / 'x.sqlite3'}")
    schema.upgrade(database, tmp_path)
    before = fill(database)
    original = schema.migration_config

    def later_config(connection: sa.Connection | None = None) -> Any:
        config = original(connection)
        config.set_main_option("script_location", str(package))
        return config

    with monkeypatch.context() as patched:
        patched.setattr(schema, "migration_config", later_config)
        schema.upgrade(database, tmp_path)
        assert schema.current_revision(database) == "later"
        # Recreating the parent table with foreign keys on would have deleted everything that refers to it.
        assert content(database) == before
        schema.downgrade(database, head)
    assert content(database) == before
    (backup,) = (tmp_path / "backups").iterdir()
    copied = Database(f"sqlite:///{backup}")
    assert content(copied) == before
    assert schema.current_revision(copied) == head
    copied.dispose()
    with database.engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar() == 1
    database.dispose()


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


def test_concurrent_increments_are_all_kept(database: Database, tmp_path: Path) -> None:
    """The loss that BEGIN IMMEDIATE prevents: read, then write, from several threads and engines at once."""
    schema.upgrade(database, tmp_path)
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
