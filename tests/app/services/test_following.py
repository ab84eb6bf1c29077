"""Looks at a session: no change is passed over, whatever the order of commits and the clock, and looks use indexes."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.records.tables import Measurement, MeasurementChange
from app.services.following import Look, Position, changes, look, start
from tests.support.environment.postgres import new_database
from tests.support.image.images import small_image
from tests.support.service.service import Api, ApiMaker


def put(api: Api, session_id: str, *numbers: int) -> list[str]:
    return [api.put_image(session_id, small_image(n), f"P{n}").json()["id"] for n in numbers]


def set_running(records: Any, measurement_id: str) -> None:
    records.execute(
        sa.update(Measurement).where(Measurement.id == measurement_id).values(status="running"),
        execution_options={"synchronize_session": False},
    )


def position(api: Api, session_id: str) -> Position:
    found = start(api.installation.database, session_id, None)
    assert found is not None
    return found.position


def looked(api: Api, session_id: str, after: Position) -> Look:
    found = look(api.installation.database, session_id, after, recount=False)
    assert found is not None
    return found


def ids(found: Look) -> list[str]:
    return [change.measurement_id for change in found.changes]


@pytest.fixture
def postgres_api(migrated_postgres: tuple[Path, str], open_api: ApiMaker, tmp_path: Path) -> Iterator[Api]:
    folder, template = migrated_postgres
    shutil.copytree(folder, tmp_path / "data")
    with new_database(template) as url, open_api(tmp_path / "data", database_url=url) as running:
        yield running


@pytest.mark.postgres
@pytest.mark.slow
def test_a_change_that_is_committed_after_a_later_one_is_not_passed_over(
    postgres_api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = postgres_api.installation.database
    session_id, other = postgres_api.make_session(), postgres_api.make_session()
    one, two = put(postgres_api, session_id, 1, 2)
    (elsewhere,) = put(postgres_api, other, 3)
    before = position(postgres_api, session_id)
    with database.engine.begin() as slow:
        set_running(slow, one)
        set_running(slow, elsewhere)
        with database.write() as records:
            set_running(records, two)
        open_still = looked(postgres_api, session_id, before)
        assert (open_still.changes, open_still.are_all, open_still.position) == ([], False, before)
        begun = position(postgres_api, session_id)
        with monkeypatch.context() as patch:
            patch.setattr(changes, "MAX_WAIT_S", 0.0)
            assert ids(looked(postgres_api, session_id, before)) == [two], "none holds others up for long"
    assert ids(looked(postgres_api, session_id, begun)) == [one, two], "who began meanwhile missed neither"
    found = looked(postgres_api, session_id, before)
    assert (ids(found), found.are_all) == ([one, two], True)
    assert [change.status for change in found.changes] == ["running", "running"]


@pytest.mark.postgres
@pytest.mark.slow
def test_a_transaction_holds_one_lock_however_much_it_changes(postgres_api: Api) -> None:
    session_id = postgres_api.make_session()
    sent = put(postgres_api, session_id, 1, 2, 3)
    database = postgres_api.installation.database
    held = sa.text(
        "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND objsubid = 1 "
        "AND CAST(classid AS bigint) > 0 AND pid = pg_backend_pid()"
    )
    with database.engine.connect() as connection:
        for _ in range(2):
            with connection.begin():
                assert connection.scalar(held) == 0
                for measurement_id in sent:
                    set_running(connection, measurement_id)
                    connection.execute(sa.text("UPDATE measurements SET status = 'queued'"))
                assert connection.scalar(held) == 1


def test_changes_of_many_at_once_are_all_seen(any_api: Api) -> None:
    """Writers and a reader at the same time: the reader sees every measurement reach its last status."""
    session_id = any_api.make_session()
    sent = put(any_api, session_id, *range(1, 13))
    database = any_api.installation.database
    seen: dict[str, str] = {}
    at = position(any_api, session_id)

    def write(some: list[str]) -> None:
        for status in ("running", "queued", "running", "failed"):
            for measurement_id in some:
                with database.write() as records:
                    records.execute(
                        sa.update(Measurement).where(Measurement.id == measurement_id).values(status=status),
                        execution_options={"synchronize_session": False},
                    )

    writers = [threading.Thread(target=write, args=(sent[k::4],)) for k in range(4)]
    for writer in writers:
        writer.start()
    while True:
        is_last = not any(writer.is_alive() for writer in writers)
        found = looked(any_api, session_id, at)
        seen |= {change.measurement_id: change.status for change in found.changes}
        at = found.position
        if is_last and found.are_all:
            break
    assert seen == dict.fromkeys(sent, "failed")


def test_a_clock_set_back_loses_nothing(any_api: Api) -> None:
    session_id = any_api.make_session()
    one, two = put(any_api, session_id, 1, 2)
    with any_api.installation.database.write() as records:
        records.execute(
            sa.update(MeasurementChange)
            .where(MeasurementChange.measurement_id == two)
            .values(number=MeasurementChange.number + 3_600_000_000)
        )
    before = position(any_api, session_id)
    assert before.measurement_id == two
    with any_api.installation.database.write() as records:
        set_running(records, one)
    found = looked(any_api, session_id, before)
    assert (ids(found), found.are_all) == ([one], True)
    assert position(any_api, session_id) == found.position


def test_a_status_set_to_what_it_was_is_no_change(any_api: Api) -> None:
    session_id = any_api.make_session()
    (one,) = put(any_api, session_id, 1)
    before = position(any_api, session_id)
    with any_api.installation.database.write() as records:
        records.execute(sa.update(Measurement).values(status="queued", attempts=2))
        records.execute(sa.update(Measurement).where(Measurement.id == "none").values(status="failed"))
    assert looked(any_api, session_id, before).changes == []
    assert any_api.measurement(one)["attempts"] == 2


def test_a_look_walks_an_index_and_reads_what_it_returns(api: Api) -> None:
    session_id = api.make_session()
    put(api, session_id, 1)
    database = api.installation.database
    asked: list[tuple[str, Any]] = []
    with database.read() as records:
        connection = records.connection()

        def note(_connection: Any, _cursor: Any, statement: str, values: Any, *_: Any) -> None:
            asked.append((statement, values))

        sa.event.listen(connection, "before_cursor_execute", note)
        changes.read_changes(records, session_id, Position(0, ""))
        changes.latest_position(records, session_id)
        selects = [each for each in asked if each[0].startswith("SELECT")]
        plans = [
            str(row[-1])
            for statement, values in selects
            for row in connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", values).all()
        ]
    assert len(selects) == 2
    assert all(step.startswith("SEARCH") for step in plans), plans
    assert sum("ix_measurement_changes_session_id_number_measurement_id" in step for step in plans) == 2
