"""Columns and tables of single revisions come and go, and the rows of others keep what they hold."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest
import sqlalchemy as sa

from app.records import migrations
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import (
    Measurement,
    MeasurementChange,
    Pose,
    Result,
    Session,
    SessionTarget,
    Target,
    target_fields,
)
from tests.support.records.filled_tables import NOW, SINCE_0004, fill, lacking
from tests.support.service.backups import content


def test_markers_come_and_go_and_leave_the_result_as_it_was(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    with database.write() as records:
        records.execute(sa.update(Result).values(markers=bytes(range(68))))
    assert content(database)["results"][0]["markers"] == bytes(range(68))
    migrations.downgrade(database, "0002")
    assert "markers" not in {column["name"] for column in sa.inspect(database.engine).get_columns("results")}
    migrations.upgrade(database, tmp_path)
    assert content(database) == lacking(before, *SINCE_0004)


def test_images_of_sessions_with_one_target_named_none(database: Database, tmp_path: Path) -> None:
    """To send such an image again without naming the target must find it, however many targets the session has now."""
    migrations.upgrade(database, tmp_path)
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
        for stated in (target.id, second):
            of_target = {"id": new_id("mea"), "target_id": stated, "stated_target_id": stated}
            records.add(Measurement(**{**fields, **of_target}))
    before = content(database)
    migrations.downgrade(database, "0003")
    migrations.upgrade(database, tmp_path)
    assert content(database) == lacking(before, *SINCE_0004)
    seeking = {row["session_id"]: row["seeks_target"] for row in content(database)["measurements"]}
    assert seeking == {one.id: True, both.id: False}


def test_only_what_shows_no_target_is_lost_on_the_way_down(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
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
    migrations.downgrade(database, "0003")
    migrations.upgrade(database, tmp_path)
    assert content(database) == lacking(before, *SINCE_0004)


def test_one_image_is_searched_for_targets_once(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    row = {**fill(database)["measurements"][0], "target_id": None}
    with pytest.raises(sa.exc.IntegrityError), database.write() as records:
        records.add(Measurement(**{**row, "id": new_id("mea")}))
    with database.write() as records:
        for _ in range(2):  # without seeking, targets that are not known do not hinder one another
            records.add(Measurement(**{**row, "id": new_id("mea"), "seeks_target": False}))


def test_images_that_do_not_search_stated_their_target(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    searched = fill(database)["measurements"][0]
    second = new_id("tgt")
    with database.write() as records:
        (target,) = records.scalars(sa.select(Target)).all()
        records.add(Target(id=second, **{**target_fields(target), "columns": 5}, name="b", created_at=NOW))
        records.flush()
        found = {**searched, "id": new_id("mea"), "seeks_target": False, "target_id": second}
        records.add(Measurement(**found))
        stated = {"sha256": "1" * 64, "target_id": second, "stated_target_id": second}
        records.add(Measurement(**{**found, "id": new_id("mea"), **stated}))
    before = content(database)
    migrations.downgrade(database, "0027")
    assert "stated_target_id" not in {
        column["name"] for column in sa.inspect(database.engine).get_columns("measurements")
    }
    migrations.upgrade(database, tmp_path)
    assert content(database) == before


def test_labelling_and_capture_quality_come_and_go(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    quality = {"tilt": 0.1 + 0.2, "advice": []}
    with database.write() as records:
        records.execute(sa.update(Result).values(labelling="up_to_symmetry", capture_quality=quality))
    assert content(database)["results"][0]["capture_quality"] == quality
    migrations.downgrade(database, "0003")
    names = {column["name"] for column in sa.inspect(database.engine).get_columns("results")}
    assert not names & {"origin", "capture_quality"}
    migrations.upgrade(database, tmp_path)
    assert content(database) == lacking(before, *SINCE_0004)


def test_why_a_retry_changed_nothing_comes_and_goes(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    failure = {"code": "worker_crashed", "detail": "It died.", "advice": None}
    with database.write() as records:
        records.execute(sa.update(Measurement).values(retry_failure=failure))
    assert content(database)["measurements"][0]["retry_failure"] == failure
    migrations.downgrade(database, "0004")
    names = {column["name"] for column in sa.inspect(database.engine).get_columns("measurements")}
    assert "retry_failure" not in names
    with pytest.raises(sa.exc.IntegrityError), database.write() as records:
        records.execute(sa.text("UPDATE measurements SET status = 'lost'"))
    migrations.upgrade(database, tmp_path)
    assert content(database) == lacking(before, *SINCE_0004)


def test_the_state_that_nothing_reads_goes_and_comes_back_empty(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    migrations.downgrade(database, "0008")
    with database.engine.begin() as connection:
        assert connection.scalar(sa.text("SELECT count(*) FROM results WHERE state IS NULL")) == 1
        state = sa.table("results", sa.column("state", sa.LargeBinary()))
        connection.execute(sa.update(state).values(state=bytes(range(256))))
    migrations.upgrade(database, tmp_path)
    assert "state" not in {column["name"] for column in sa.inspect(database.engine).get_columns("results")}
    assert content(database) == before


def test_exclusions_come_and_go(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    exclusion = {"reason": "x", "by": None, "at": NOW.isoformat()}
    with database.write() as records:
        records.execute(sa.update(Measurement).values(excluded=exclusion))
    assert content(database)["measurements"][0]["excluded"] == exclusion
    migrations.downgrade(database, "0010")
    names = {column["name"] for column in sa.inspect(database.engine).get_columns("measurements")}
    assert "excluded" not in names
    migrations.upgrade(database, tmp_path)
    assert content(database) == before


def test_conditions_come_and_go(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    with database.write() as records:
        records.execute(sa.update(Session).values(conditions={"load_kg": 3.0}))
    assert content(database)["sessions"][0]["conditions"] == {"load_kg": 3.0}
    migrations.downgrade(database, "0012")
    migrations.upgrade(database, tmp_path)
    assert content(database) == before


def test_changes_of_measurements_are_numbered_from_the_migration_on(
    database: Database, tmp_path: Path
) -> None:
    migrations.upgrade(database, tmp_path)
    measurement_id = fill(database)["measurements"][0]["id"]
    migrations.downgrade(database, "0026")
    with database.engine.begin() as connection:
        connection.execute(sa.text("UPDATE measurements SET status = 'failed'"))
    migrations.upgrade(database, tmp_path)
    with database.write() as records:
        assert records.scalars(sa.select(MeasurementChange)).all() == [], (
            "nothing is written for rows there are"
        )
        records.execute(sa.update(Measurement).values(status="queued"))
        (first,) = records.scalars(sa.select(MeasurementChange.number)).all()
        records.execute(sa.update(Measurement).values(status="running"))
        (second,) = records.scalars(sa.select(MeasurementChange.number)).all()
        assert second > first
        assert abs(first / 1e6 - datetime.now(UTC).timestamp()) < 3600, "microseconds since 1970"
        records.execute(sa.delete(Measurement).where(Measurement.id == measurement_id))
        assert records.scalars(sa.select(MeasurementChange)).all() == []
