"""The schema's ways up and down, with data in it, on both databases."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic import command

from app.records import migrations
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import (
    Installation,
    Notice,
    NoticeMark,
    Qualification,
    Report,
    ReportForm,
    ReportSummary,
    Robot,
    RobotEvent,
    Webhook,
    WebhookDelivery,
)
from tests.support.records.filled_tables import NOW, SINCE_0004, fill, lacking, revisions
from tests.support.service.backups import content

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


def test_every_step_down_says_what_it_loses() -> None:
    known = revisions()
    steps = migrations.what_is_lost(known[-1], known[0])
    assert [revision for revision, _ in steps] == known[:0:-1]
    assert all(loss.endswith(".") for _, loss in steps)
    assert [revision for revision, _ in migrations.earlier_revisions(known[-1])] == known[-2::-1]
    for current, revision in ((known[0], known[0]), (known[0], known[1]), (known[1], "none")):
        with pytest.raises(migrations.NotOnTheWayDown):
            migrations.what_is_lost(current, revision)
