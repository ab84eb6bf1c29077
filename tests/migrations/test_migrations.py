"""The schema's ways up and down, with data in it, on both databases."""

from __future__ import annotations

import json
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

from app.records import migrations
from app.records.codec import content_hash
from app.records.database import Database, sqlite_driver
from app.records.ids import new_id
from app.records.tables import (
    ApiKey,
    AuditEntry,
    Installation,
    MeasuredPose,
    Measurement,
    MeasurementChange,
    Notice,
    NoticeMark,
    Pose,
    Qualification,
    Removal,
    Report,
    ReportForm,
    ReportSummary,
    Result,
    Robot,
    RobotEvent,
    Session,
    SessionTarget,
    Target,
    Webhook,
    WebhookDelivery,
    target_fields,
)
from tests.support.environment.postgres import EITHER_DATABASE
from tests.support.service.backups import content

SINCE_0004 = ("removals",)
SINCE_THE_FIRST = (
    "measured_poses",
    "installation",
    "reports",
    "report_forms",
    "qualifications",
    "robot_events",
    "report_summaries",
    "notices",
    "notice_marks",
    "webhooks",
    "webhook_deliveries",
    *SINCE_0004,
)
WRITTEN_BY_ACTIVITIES = ("audit_entries",)
NOW = datetime(2026, 1, 31, 12, 0, 0, 123456, tzinfo=UTC)


@pytest.fixture(params=EITHER_DATABASE)
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """An empty database of either kind."""
    url = f"sqlite:///{tmp_path / 'x.sqlite3'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("postgres_url")
    database = Database(url)
    yield database
    database.dispose()


def fill(database: Database) -> dict[str, list[dict[str, Any]]]:
    """Put a row into every table but the audit trail and the installation, and return what each then holds."""
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
        records.add(Removal(sha256="1" * 64, recorded_at=NOW))
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
                points=b"\0\1",
                content_sha256=content_hash(b"\0\1", None),
                core_version="1",
                settings={},
                input_sha256="0" * 64,
            )
        )
    return content(database)


def lacking(content: dict[str, list[dict[str, Any]]], *tables: str) -> dict[str, list[dict[str, Any]]]:
    """Return the content without the rows of tables that the revision gone back to does not have."""
    return {**content, **{table: [] for table in tables}}


def revisions() -> list[str]:
    """Every revision, first to last."""
    scripts = ScriptDirectory.from_config(migrations.migration_config())
    return [script.revision for script in reversed(list(scripts.walk_revisions()))]


def test_the_way_up_ends_at_the_tables_the_program_uses(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    assert migrations.current_revision(database) == migrations.head_revision()
    with database.engine.connect() as connection, connection.begin():
        command.check(migrations.migration_config(connection))


def test_every_step_up_and_down_keeps_the_data_it_can(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    fill(database)
    with database.write() as records:
        records.add(Installation(id=new_id("ins"), created_at=NOW, pepper_check="0" * 64))
        report_id = new_id("rep")
        records.add(
            Report(
                id=report_id,
                session_id=new_id("ses"),
                kind="camera",
                title="ø",
                signatories=[{"name": "ø", "role": None}],
                paper="a4",
                status="succeeded",
                attempts=1,
                created_at=NOW,
                finished_at=NOW,
            )
        )
        records.add(
            Qualification(
                id=new_id("qua"),
                session_id=new_id("ses"),
                session_name="ø",
                made_at=NOW,
                due_at=NOW,
                worst_error_mm=0.1 + 0.2,
                scale_ppm=-3.5,
                analysis={"ø": 1},
            )
        )
        robot_id = records.scalar(sa.select(Robot.id))
        records.add(
            RobotEvent(
                id=new_id("eve"), robot_id=robot_id, at=NOW, note="ø", restarts_charts=True, created_at=NOW
            )
        )
        records.flush()
        notice_id, webhook_id = new_id("ntc"), new_id("whk")
        records.add(Notice(id=notice_id, number=1, type="report.ready", at=NOW, data={"ø": 1}))
        records.add(NoticeMark(name="looked", at=NOW))
        records.add(Webhook(id=webhook_id, name="ø", url="http://x/", types=["report.ready"], created_at=NOW))
        records.flush()
        records.add(
            WebhookDelivery(
                id=new_id("dlv"),
                webhook_id=webhook_id,
                notice_id=notice_id,
                status="waiting",
                attempts=1,
                created_at=NOW,
                next_attempt_at=NOW,
            )
        )
        records.add(ReportSummary(report_id=report_id, summary={"ø": 1}))
        records.add(ReportForm(report_id=report_id, form="csv", sha256="0" * 64, bytes=2, content=b"\0\1"))
    before = content(database)
    assert all(len(rows) == 1 for table, rows in before.items() if table not in WRITTEN_BY_ACTIVITIES)
    known = revisions()
    # Down to the first revision and up again: what the first tables hold survives every later change.
    migrations.downgrade(database, known[0])
    migrations.upgrade(database, tmp_path)
    assert content(database) == lacking(before, *SINCE_THE_FIRST)


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
        records.add(Measurement(**{**fields, "id": new_id("mea")}))
        records.add(Measurement(**{**fields, "id": new_id("mea"), "target_id": second}))
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


def test_stored_documents_take_the_names_of_the_contract(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    fill(database)
    joint = {"a_mm": 1.5, "minimum_deg": -90.0, "maximum_deg": 90.0}
    calibration = {
        "initialisation": "nullspace",
        "pose": {"covariance_given_camera": [[1.0]]},
        "observability": {"ambiguity_log_likelihood_ratio": None, "tilt_deg": 3.0},
    }
    with database.write() as records:
        records.execute(sa.update(Robot).values(joints=[joint], datasheet_repeatability_mm=0.04))
        records.execute(sa.update(Result).values(calibration=calibration, labelling="up_to_symmetry"))
    before = content(database)
    migrations.downgrade(database, "0009")
    with database.engine.begin() as connection:
        older = connection.execute(sa.text("SELECT origin, calibration FROM results")).one()
        assert older[0] == "turned"
        stored = older[1] if isinstance(older[1], dict) else json.loads(older[1])
        assert stored["start"] == "nullspace"
        assert stored["pose"] == {"conditional_covariance": [[1.0]]}
        assert stored["observability"] == {"pose_ambiguity_ratio": None, "tilt_deg": 3.0}
        joints, repeatability_mm = connection.execute(
            sa.text("SELECT joints, repeatability_mm FROM robots")
        ).one()
        joints = joints if isinstance(joints, list) else json.loads(joints)
        assert (joints[0]["lower_deg"], joints[0]["upper_deg"], repeatability_mm) == (-90.0, 90.0, 0.04)
        # The older version's statistic cannot be converted: a retry computes the new one.
        stored["observability"]["pose_ambiguity_ratio"] = 0.5
        connection.execute(sa.text("UPDATE results SET calibration = :new"), {"new": json.dumps(stored)})
    migrations.upgrade(database, tmp_path)
    assert content(database) == before


def test_stored_calibrations_get_their_grade_and_interval(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    fill(database)
    calibration = {
        "grade": "weak",
        "intrinsics": {"fx_px": 1000.0, "fy_px": 900.0},
        "standard_uncertainty": {"fx_px": 50.0, "fy_px": 45.0},
        "interval_95": {"fx_px": [906.650, 1102.961], "fy_px": [815.985, 992.665]},
        "observability": {"focal_relative_uncertainty": 0.05},
    }
    with database.write() as records:
        records.execute(sa.update(Result).values(calibration=calibration))
    migrations.downgrade(database, "0011")
    with database.engine.begin() as connection:
        stored = connection.scalar(sa.text("SELECT calibration FROM results"))
        older = stored if isinstance(stored, dict) else json.loads(stored)
        assert not {"grade", "interval_95"} & set(older)
    migrations.upgrade(database, tmp_path)
    (row,) = content(database)["results"]
    found = row["calibration"]
    assert found["grade"] == "weak"
    for name, interval in calibration["interval_95"].items():  # type: ignore[attr-defined]
        assert found["interval_95"][name] == pytest.approx(interval, abs=1e-3)
    assert {**found, "interval_95": None} == {**calibration, "interval_95": None}


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


def test_a_limited_key_opens_nothing_in_the_older_version(database: Database, tmp_path: Path) -> None:
    """The older version knows neither limits nor `ingest`: it would open everything to such a key."""
    migrations.upgrade(database, tmp_path)
    fill(database)
    limited = {"scope": "read", "session_ids": ["ses_x"]}
    names = {"limited": limited, "machine": {"scope": "ingest"}, "plain": {"scope": "upload"}}
    with database.write() as records:
        for name, fields in names.items():
            key = ApiKey(id=new_id("key"), name=name, secret_hmac="1" * 64, created_at=NOW, **fields)
            records.add(key)
    migrations.downgrade(database, "0004")
    with database.engine.connect() as connection:
        rows = connection.execute(sa.text("SELECT name, scope, revoked_at FROM api_keys"))
        found = {row.name: (row.scope, row.revoked_at is not None) for row in rows}
    assert found == {
        "k": ("read", False),
        "limited": ("read", True),
        "machine": ("read", True),
        "plain": ("upload", False),
    }
    migrations.upgrade(database, tmp_path)


@pytest.mark.slow
def test_results_of_before_get_the_hash_of_their_arrays(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    rows = [
        {**before["measurements"][0], "id": new_id("mea"), "sha256": f"{k:064}", "seeks_target": False}
        for k in range(1, 1204)
    ]
    kinds = [(None, None), (b"", None), (b"\1\2", b"\3"), (b"\1", b"\2\3")]
    with database.write() as records:
        records.execute(sa.insert(Measurement), rows)
        results = []
        for k, row in enumerate(rows):
            points, markers = kinds[k % len(kinds)]
            arrays = {
                "points": points,
                "markers": markers,
                "content_sha256": content_hash(points, markers),
            }
            results.append({**before["results"][0], **arrays, "measurement_id": row["id"]})
        records.execute(sa.insert(Result), results)
    before = content(database)
    assert len({row["content_sha256"] for row in before["results"]}) == 1 + len(kinds)
    migrations.downgrade(database, "0004")
    migrations.upgrade(database, tmp_path)
    assert content(database) == lacking(before, *SINCE_0004)


def test_an_installation_is_one(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    with database.write() as records:
        records.add(Installation(id=new_id("ins"), created_at=NOW))
    for number in (1, 2):
        with pytest.raises(sa.exc.IntegrityError), database.write() as records:
            records.execute(sa.insert(Installation).values(number=number, id=new_id("ins"), created_at=NOW))


def test_the_way_down_ends_at_nothing(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    fill(database)
    migrations.downgrade(database, "base")
    assert migrations.current_revision(database) is None
    assert set(sa.inspect(database.engine).get_table_names()) <= {"alembic_version"}
    migrations.upgrade(database, tmp_path)
    assert all(rows == [] for rows in content(database).values())


def test_several_processes_may_upgrade_at_once(database: Database, tmp_path: Path) -> None:
    others = [Database(database.url.render_as_string(hide_password=False)) for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda other: migrations.upgrade(other, tmp_path), others))
    for other in others:
        other.dispose()
    assert migrations.current_revision(database) == migrations.head_revision()


def test_a_schema_from_the_future_is_left_alone(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    with database.write() as records:
        records.execute(sa.text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(migrations.SchemaTooNew):
        migrations.upgrade(database, tmp_path)


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


def test_every_step_down_says_what_it_loses() -> None:
    known = revisions()
    steps = migrations.what_is_lost(known[-1], known[0])
    assert [revision for revision, _ in steps] == known[:0:-1]
    assert all(loss.endswith(".") for _, loss in steps)
    assert [revision for revision, _ in migrations.earlier_revisions(known[-1])] == known[-2::-1]
    for current, revision in ((known[0], known[0]), (known[0], known[1]), (known[1], "none")):
        with pytest.raises(migrations.NotOnTheWayDown):
            migrations.what_is_lost(current, revision)


def test_the_newest_copies_are_kept(tmp_path: Path) -> None:
    database = Database(f"sqlite:///{tmp_path / 'x.sqlite3'}")
    migrations.upgrade(database, tmp_path)
    (tmp_path / "backups").mkdir()
    (tmp_path / "backups" / "mine.sqlite3").touch()
    # By their time, whatever revision they are of.
    made = [migrations.back_up(database, tmp_path / "backups", revision) for revision in "98765"]
    database.dispose()
    left = {path.name for path in (tmp_path / "backups").iterdir()}
    assert left == {"mine.sqlite3", *(path.name for path in made[-migrations.KEPT_COPIES :])}


def test_an_existing_database_is_copied_before_it_is_changed(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    migrations.downgrade(database, revisions()[-2])
    migrations.upgrade(database, tmp_path)
    (backup,) = (tmp_path / "backups").iterdir()
    assert backup.stat().st_mode & 0o077 == 0
    copied = Database(f"sqlite:///{backup}")
    assert migrations.current_revision(copied) == revisions()[-2]
    migrations.upgrade(copied, tmp_path, copy_first=False)
    assert content(copied) == before
    copied.dispose()


def test_a_copy_is_of_one_schema_and_content(database: Database, tmp_path: Path) -> None:
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    backup = migrations.back_up(database, tmp_path / "backups", "0001")
    copied = Database(f"sqlite:///{backup}")
    assert content(copied) == before
    copied.dispose()


def test_an_upgrade_backs_up_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later revision, made here, is applied to a database with data in it."""
    package = tmp_path / "later" / "migrations"
    shutil.copytree(Path(migrations.migration_config().get_main_option("script_location") or ""), package)
    head = migrations.head_revision()
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
    migrations.upgrade(database, tmp_path)
    before = fill(database)
    original = migrations.migration_config

    def later_config(connection: sa.Connection | None = None) -> Any:
        config = original(connection)
        config.set_main_option("script_location", str(package))
        return config

    with monkeypatch.context() as patched:
        patched.setattr(migrations, "migration_config", later_config)
        migrations.upgrade(database, tmp_path)
        assert migrations.current_revision(database) == "later"
        # Recreating the parent table with foreign keys on would have deleted everything that refers to it.
        assert content(database) == before
        migrations.downgrade(database, head)
    assert content(database) == before
    (backup,) = (tmp_path / "backups").iterdir()
    copied = Database(f"sqlite:///{backup}")
    assert content(copied) == before
    assert migrations.current_revision(copied) == head
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
