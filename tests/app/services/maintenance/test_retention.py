"""Retention: what is old goes as a whole, and no jump of the clock removes anything."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.records.ids import moment_of, new_id
from app.records.tables import Measurement
from app.services.archive import archive_session, restore_session
from app.services.maintenance.retention import MAX_GAP, STATE, Retention, apply_retention
from app.services.sessions import delete_session

DAYS = 30


@pytest.fixture
def keeping_api(open_api: Any) -> Iterator[Any]:
    with open_api(retention_days=DAYS) as api:
        # The service's own rounds know the true time, which the tests do without.
        api.service.maintenance.stop()
        (api.installation.settings.data_dir / STATE).unlink(missing_ok=True)
        yield api


def later(**time: float) -> datetime:
    return datetime.now(UTC) + timedelta(**time)


def old_session(api: Any, data: bytes, status: str = "succeeded") -> str:
    session_id: str = api.make_session()
    assert api.put_image(session_id, data).status_code == 202
    with api.installation.database.write() as records:
        records.execute(
            sa.update(Measurement).where(Measurement.session_id == session_id).values(status=status)
        )
    return session_id


def sessions(api: Any) -> list[str]:
    return [item["id"] for item in api.client.get("/v1/sessions").json()["items"]]


def originals(api: Any) -> int:
    return sum(1 for path in api.installation.blobs.root.glob("[0-9a-f][0-9a-f]/*") if path.is_file())


def test_ids_say_when_they_were_made() -> None:
    before = datetime.now(UTC) - timedelta(milliseconds=2)
    assert before <= moment_of(new_id("ses")) <= datetime.now(UTC) + timedelta(seconds=1)


def test_nothing_is_removed_unless_it_is_asked_for(api: Any, grey_png: bytes) -> None:
    session_id = old_session(api, grey_png)
    assert apply_retention(api.installation, later(days=100_000)) == []
    assert Retention(api.installation).run(later(days=100_000), 0.0) == []
    assert sessions(api) == [session_id]


def test_a_session_goes_with_its_originals_once_its_last_upload_is_too_old(
    keeping_api: Any, grey_png: bytes
) -> None:
    session_id = old_session(keeping_api, grey_png)
    assert apply_retention(keeping_api.installation, later(days=DAYS - 1)) == []
    assert (sessions(keeping_api), originals(keeping_api)) == ([session_id], 1)
    (expired,) = apply_retention(keeping_api.installation, later(days=DAYS + 1))
    assert (expired.session_id, expired.name) == (session_id, "session")
    assert (sessions(keeping_api), originals(keeping_api)) == ([], 0)
    assert apply_retention(keeping_api.installation, later(days=DAYS + 2)) == []


def test_an_original_that_a_younger_session_holds_stays(
    keeping_api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = old_session(keeping_api, grey_png)
    monkeypatch.setattr("app.records.ids.time.time_ns", lambda: int(later(days=20).timestamp() * 1e9))
    monkeypatch.setattr("app.records.ids._last", 0)
    young = old_session(keeping_api, grey_png)
    assert [e.session_id for e in apply_retention(keeping_api.installation, later(days=DAYS + 1))] == [old]
    assert (sessions(keeping_api), originals(keeping_api)) == ([young], 1)


def test_a_young_pose_or_image_keeps_an_old_session(
    keeping_api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = [old_session(keeping_api, grey_png + b"%d" % number) for number in range(3)]
    gone = old_session(keeping_api, grey_png)
    monkeypatch.setattr("app.records.ids.time.time_ns", lambda: int(later(days=20).timestamp() * 1e9))
    monkeypatch.setattr("app.records.ids._last", 0)
    client = keeping_api.client
    assert client.put(f"/v1/sessions/{kept[0]}/poses/P9", json={}).status_code == 201
    reading = [{"pose_id": "P1", "cycle": 1, "position_mm": [1.0, 2.0, 3.0]}]
    assert client.post(f"/v1/sessions/{kept[1]}/measured-poses", json=reading).status_code == 200
    assert keeping_api.put_image(kept[2], grey_png + b"new").status_code == 202
    removed = apply_retention(keeping_api.installation, later(days=DAYS + 1))
    assert [expired.session_id for expired in removed] == [gone]
    assert sorted(sessions(keeping_api)) == sorted(kept)


def test_the_days_of_a_session_from_an_archive_count_from_its_restore(
    keeping_api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    installation, archive = keeping_api.installation, tmp_path / "old.tar.gz"
    with monkeypatch.context() as long_ago:
        long_ago.setattr("app.records.ids.time.time_ns", lambda: int(later(days=-100).timestamp() * 1e9))
        long_ago.setattr("app.records.ids._last", 0)
        session_id = old_session(keeping_api, grey_png)
        not_restored = old_session(keeping_api, grey_png + b"another")
        archive_session(installation, session_id, archive)
        assert delete_session(installation.database, installation.blobs, session_id)
    restore_session(installation, archive)
    assert [expired.session_id for expired in apply_retention(installation, later())] == [not_restored]
    assert apply_retention(installation, later(days=DAYS - 1)) == []
    assert sessions(keeping_api) == [session_id]
    assert [expired.session_id for expired in apply_retention(installation, later(days=DAYS + 1))] == [
        session_id
    ]


@pytest.mark.parametrize("status", ["queued", "running"])
def test_images_that_are_not_computed_yet_keep_their_session(
    keeping_api: Any, grey_png: bytes, status: str
) -> None:
    session_id = old_session(keeping_api, grey_png, status)
    assert apply_retention(keeping_api.installation, later(days=10 * DAYS)) == []
    assert sessions(keeping_api) == [session_id]


def run_daily(retention: Retention, start: datetime, days: int) -> int:
    """Run once a day, in step with the time passed; return how many sessions went."""
    return sum(len(retention.run(start + timedelta(days=day), 86400.0 * day)) for day in range(days))


def test_a_clock_that_agrees_with_itself_for_a_day_is_trusted(keeping_api: Any, grey_png: bytes) -> None:
    old_session(keeping_api, grey_png)
    retention, start = Retention(keeping_api.installation), later(days=DAYS + 1)
    assert retention.run(start, 0.0) == []
    assert retention.run(start + timedelta(hours=23), 23 * 3600.0) == []
    assert len(retention.run(start + timedelta(hours=24), 24 * 3600.0)) == 1


def test_a_clock_that_jumps_ahead_by_years_removes_nothing(keeping_api: Any, grey_png: bytes) -> None:
    session_id = old_session(keeping_api, grey_png)
    retention, start = Retention(keeping_api.installation), later()
    assert run_daily(retention, start, 3) == 0
    jumped = start + timedelta(days=2, hours=1) + timedelta(days=3650)
    assert retention.run(jumped, 86400.0 * 2 + 3600.0) == []
    assert retention.run(jumped + timedelta(hours=10), 86400.0 * 2 + 11 * 3600.0) == []
    # Set right again within the day: the agreement begins anew, and what is young stays.
    right = start + timedelta(days=2, hours=12)
    assert retention.run(right, 86400.0 * 2.5) == []
    assert run_daily(retention, right, 3) == 0
    assert sessions(keeping_api) == [session_id]


def test_a_clock_that_keeps_jumping_removes_nothing(keeping_api: Any, grey_png: bytes) -> None:
    session_id = old_session(keeping_api, grey_png)
    retention, now = Retention(keeping_api.installation), later()
    for day in range(20):
        now += timedelta(
            days=5
        )  # less than the gap that is allowed between two runs, and more than has passed
        assert retention.run(now, 86400.0 * day) == []
    assert sessions(keeping_api) == [session_id]


def test_a_jump_across_a_restart_removes_nothing_for_a_day(keeping_api: Any, grey_png: bytes) -> None:
    session_id = old_session(keeping_api, grey_png)
    start = later()
    assert run_daily(Retention(keeping_api.installation), start, 5) == 0
    wrong = start + timedelta(days=4) + MAX_GAP + timedelta(days=365)
    assert Retention(keeping_api.installation).run(wrong, 5.0) == []
    assert Retention(keeping_api.installation).run(wrong + timedelta(hours=20), 9.0) == []
    assert sessions(keeping_api) == [session_id]
    assert Retention(keeping_api.installation).run(start + timedelta(days=5), 9.0) == []
    assert Retention(keeping_api.installation).run(start + timedelta(days=5, hours=20), 9.0) == []
    assert sessions(keeping_api) == [session_id]


@pytest.mark.parametrize("how", ["while it runs", "switched off"])
def test_a_clock_that_was_behind_and_is_set_right_removes_nothing_made_before(
    keeping_api: Any, grey_png: bytes, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """A dead battery: what was sent meanwhile used to look years old, and went a day after the clock was set right."""
    right = later()
    behind = right - timedelta(days=730)
    monkeypatch.setattr("app.records.ids.time.time_ns", lambda: int(behind.timestamp() * 1e9))
    monkeypatch.setattr("app.records.ids._last", 0)
    session_id = old_session(keeping_api, grey_png)
    assert moment_of(session_id) < right - timedelta(days=700)
    retention = Retention(keeping_api.installation)
    assert retention.run(behind, 0.0) == []
    assert retention.run(behind + timedelta(minutes=10), 600.0) == []
    if how == "switched off":
        retention = Retention(keeping_api.installation)
    for day in range(DAYS):
        assert retention.run(right + timedelta(days=day), 1200.0 + 86400.0 * day) == []
        if day % 7 == 0:  # the jump is known to the next process too
            retention = Retention(keeping_api.installation)
    assert sessions(keeping_api) == [session_id]
    (expired,) = retention.run(right + timedelta(days=DAYS), 1200.0 + 86400.0 * DAYS)
    assert expired.session_id == session_id


def test_a_clock_that_was_ahead_and_is_set_right_removes_what_is_old_by_then(
    keeping_api: Any, grey_png: bytes
) -> None:
    old_session(keeping_api, grey_png)
    retention, start = Retention(keeping_api.installation), later()
    assert run_daily(retention, start, 2) == 0
    assert retention.run(start + timedelta(days=3650), 86400.0 * 2) == []
    removed = [
        len(retention.run(start + timedelta(days=day), 86400.0 * day)) for day in range(3, 3 + DAYS + 1)
    ]
    assert removed == [0] * DAYS + [1]


def test_retention_stops_when_it_is_asked_to(keeping_api: Any, grey_png: bytes) -> None:
    ids = [old_session(keeping_api, grey_png + b"%d" % number) for number in range(3)]
    answers = iter([False, True])
    removed = apply_retention(
        keeping_api.installation, later(days=DAYS + 1), stopped=lambda: next(answers, True)
    )
    assert [expired.session_id for expired in removed] == ids[:1]
    retention, start = Retention(keeping_api.installation), later(days=DAYS + 1)
    assert retention.run(start, 0.0) == []
    assert retention.run(start + timedelta(days=1), 86400.0, stopped=lambda: True) == []
    assert sorted(sessions(keeping_api)) == ids[1:]


@pytest.mark.parametrize("damaged", ["ses_0", "!!!!!!", "ses_" + "z" * 26])
def test_a_session_whose_id_is_damaged_stays_and_keeps_no_other(
    keeping_api: Any, grey_png: bytes, damaged: str
) -> None:
    """It used to end every round, or to look as old as can be."""
    target_id = keeping_api.make_target()
    session_id = keeping_api.make_session(target_id)
    other = old_session(keeping_api, grey_png)
    with keeping_api.installation.database.write() as records:
        records.execute(sa.text("PRAGMA defer_foreign_keys=1"))
        for table, column in (("session_targets", "session_id"), ("sessions", "id")):
            records.execute(
                sa.text(f"UPDATE {table} SET {column} = :damaged WHERE {column} = :id"),
                {"damaged": damaged, "id": session_id},
            )
    removed = apply_retention(keeping_api.installation, later(days=DAYS + 1))
    assert [expired.session_id for expired in removed] == [other]
    with keeping_api.installation.database.read() as records:
        assert records.scalar(sa.text("SELECT count(*) FROM sessions")) == 1


def test_a_computer_switched_off_every_night_removes_what_is_old(keeping_api: Any, grey_png: bytes) -> None:
    old_session(keeping_api, grey_png)
    start = later(days=DAYS + 1)
    removed = [
        len(Retention(keeping_api.installation).run(start + timedelta(days=day), 60.0)) for day in (0, 1, 4)
    ]
    assert removed == [0, 1, 0]


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b'{"since": "2020-01-01", "last": "2020-01-01"}', b"\xff"]
)
def test_a_damaged_file_begins_the_agreement_anew(keeping_api: Any, grey_png: bytes, content: bytes) -> None:
    old_session(keeping_api, grey_png)
    (keeping_api.installation.settings.data_dir / STATE).write_bytes(content)
    retention, start = Retention(keeping_api.installation), later(days=DAYS + 1)
    assert retention.run(start, 0.0) == []
    assert len(retention.run(start + timedelta(days=1), 86400.0)) == 1


@pytest.mark.slow
@pytest.mark.postgres
def test_retention_on_postgresql(open_api: Any, postgres_url: str, tmp_path: Any, grey_png: bytes) -> None:
    with open_api(tmp_path / "data", database_url=postgres_url, retention_days=DAYS) as api:
        session_id = old_session(api, grey_png)
        pending = old_session(api, grey_png + b"1", "queued")
        removed = apply_retention(api.installation, later(days=DAYS + 1))
        assert [expired.session_id for expired in removed] == [session_id]
        assert (sessions(api), originals(api)) == ([pending], 1)
