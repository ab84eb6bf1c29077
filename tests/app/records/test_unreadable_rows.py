"""Rows damaged behind the service's back: each is the trouble of nobody else, and nothing answers with a 5xx."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.jobs.queue import JobResult
from app.records.database import Database
from app.records.outcome import Failure, Outcome
from app.records.tables import Measurement, Result
from app.services.inspection import database as database_checks
from app.services.inspection.check_result import State
from tests.support.records.damaged_rows import CODE, damage, get, upload

DONE = Outcome(result=None, failure=Failure("target_not_found", "Nothing there.", None))


@pytest.fixture(params=["Pacific/Kiritimati", "America/Los_Angeles"])
def zoned_api(
    request: pytest.FixtureRequest, open_api: Any, postgres_url: str, tmp_path: Path
) -> Iterator[Any]:
    """An application on a database whose sessions begin in an odd time zone and write dates the German way."""
    name = sa.make_url(postgres_url).database
    admin = sa.create_engine(postgres_url, isolation_level="AUTOCOMMIT")
    with admin.connect() as connection:
        connection.exec_driver_sql(f"ALTER DATABASE {name} SET timezone = '{request.param}'")
        connection.exec_driver_sql(f"ALTER DATABASE {name} SET datestyle = 'German'")
    admin.dispose()
    with open_api(tmp_path / "data", database_url=postgres_url) as api:
        yield api


DAMAGE = {
    "sqlite": [
        ("captured_at = 'yesterday'", "captured_at"),
        ("captured_at = 5", "captured_at"),
        ("received_at = '2026-13-45 00:00:00'", "received_at"),
        ("joint_angles_deg = '[1, 2'", "joint_angles_deg"),
        ("joint_angles_deg = CAST(x'ff5b' AS TEXT)", "joint_angles_deg"),
        ("joint_angles_deg = '{\"a\": 1}'", "joint_angles_deg"),
        ("sha256 = '../../etc/passwd'", "sha256"),
        ("bytes = 'many'", "bytes"),
        ("focus_group = x'00ff'", "focus_group"),
        ("excluded = '{\"reason\": 1}'", "excluded"),
    ],
    "postgresql": [
        ("captured_at = 'infinity'", "captured_at"),
        ("captured_at = '-infinity'", "captured_at"),
        ("captured_at = '0044-03-15 12:00:00+00 BC'", "captured_at"),
        ("captured_at = '12026-01-01 00:00:00+00'", "captured_at"),
        ("received_at = 'infinity'", "received_at"),
        ("joint_angles_deg = '{\"a\": 1}'", "joint_angles_deg"),
        ("sha256 = '../../etc/passwd'", "sha256"),
    ],
}


@pytest.mark.slow
def test_a_damaged_measurement_fails_by_itself_and_is_shown_so_everywhere(
    any_api: Any, grey_png: bytes
) -> None:
    api, queue = any_api, any_api.installation.queue
    damages = DAMAGE[api.installation.database.engine.dialect.name]
    session_id, ids = upload(api, grey_png, "a" * (len(damages) + 1))
    *bad, good = ids
    for measurement_id, (assignment, _) in zip(bad, damages, strict=True):
        damage(api, f"UPDATE measurements SET {assignment} WHERE id = :id", id=measurement_id)
    queued = get(api, f"/v1/sessions/{session_id}/measurements")["items"]
    assert [item["status"] for item in queued] == ["failed"] * len(bad) + ["queued"]

    jobs = queue.claim(4)
    assert [job.measurement_id for job in jobs] == [good]
    assert queue.claim(4) == ()
    assert queue.finish([JobResult(jobs[0], DONE, 1.0)]) == 1

    shown = get(api, f"/v1/sessions/{session_id}/measurements")["items"]
    assert [item["id"] for item in shown] == ids
    for item, (_, column) in zip(shown, damages, strict=False):
        assert (item["status"], item["failure"]["code"]) == ("failed", CODE)
        assert column in item["failure"]["detail"]
        assert item["received_at"] <= shown[-1]["received_at"]
        assert get(api, f"/v1/measurements/{item['id']}")["failure"] == item["failure"]
        for path in ("image", "overlay"):
            assert api.client.get(f"/v1/measurements/{item['id']}/{path}").status_code < 500
    assert shown[-1]["failure"]["code"] == "target_not_found"
    counts = get(api, f"/v1/sessions/{session_id}")["counts"]
    assert (counts["queued"], counts["running"], counts["failed"]) == (0, 0, len(ids))
    assert len(get(api, f"/v1/sessions/{session_id}/measurements?status=failed")["items"]) == len(ids)
    assert api.client.get("/metrics").status_code == 200
    assert get(api, f"/v1/sessions/{session_id}/intrinsics", 409)["code"] != "internal_error"
    # Retried, it is as unreadable as before, and still nobody else's trouble.
    assert api.client.post(f"/v1/measurements/{bad[0]}/retry").status_code == 202
    assert queue.claim(4) == ()
    assert get(api, f"/v1/measurements/{bad[0]}")["failure"]["code"] == CODE


def test_a_row_damaged_while_it_is_computed_fails_by_itself(any_api: Any, grey_png: bytes) -> None:
    targets = [any_api.make_target(), any_api.make_target(columns=7)]
    session_id = any_api.make_session(*targets)
    bad, good = (any_api.put_image(session_id, grey_png + order).json()["id"] for order in (b"1", b"2"))
    jobs = any_api.installation.queue.claim(4)
    damage(any_api, "UPDATE measurements SET joint_angles_deg = '{}' WHERE id = :id", id=bad)
    assert any_api.installation.queue.finish([JobResult(job, DONE, 1.0) for job in jobs]) == 2
    items = get(any_api, f"/v1/sessions/{session_id}/measurements")["items"]
    assert [(item["id"], item["failure"]["code"]) for item in items] == [
        (bad, CODE),
        (good, "target_not_found"),
    ]


@pytest.mark.slow
def test_a_damaged_result_is_shown_as_unreadable_and_retried(any_api: Any, grey_png: bytes) -> None:
    session_id, (bad, good) = upload(any_api, grey_png, "ab")
    database = any_api.installation.database
    with database.write() as records:
        for measurement_id in (bad, good):
            records.add(
                Result(
                    measurement_id=measurement_id,
                    points=b"\0" * 45,
                    content_sha256="0" * 64,
                    core_version="1",
                    settings={},
                    input_sha256="0" * 64,
                )
            )
        records.execute(sa.update(Measurement).values(status="succeeded"))
    damage(
        any_api,
        "UPDATE results SET calibration = '{}', capture_quality = '[]' WHERE measurement_id = :id",
        id=bad,
    )
    with database.write() as records:
        records.execute(sa.update(Result).where(Result.measurement_id == bad).values(points=b"\0" * 46))
    items = get(any_api, f"/v1/sessions/{session_id}/measurements")["items"]
    assert [item["status"] for item in items] == ["failed", "succeeded"]
    assert items[0]["failure"]["code"] == CODE
    assert items[0]["failure"]["advice"]
    assert get(any_api, f"/v1/measurements/{bad}?include=points", 409)["code"] == CODE
    assert get(any_api, f"/v1/measurements/{bad}/overlay", 409)["code"] == CODE
    assert any_api.client.get(f"/v1/sessions/{session_id}/intrinsics").status_code == 409
    assert any_api.client.post(f"/v1/measurements/{bad}/retry").status_code == 202
    assert get(any_api, f"/v1/measurements/{bad}")["failure"] is None


@pytest.mark.postgres
def test_times_are_utc_whatever_the_servers_time_zone(zoned_api: Any, grey_png: bytes) -> None:
    session_id, ids = upload(zoned_api, grey_png, "ab")
    for measurement_id, text in zip(ids, ("9999-12-31 23:59:59+00", "0001-01-01 00:00:00+00"), strict=True):
        damage(zoned_api, f"UPDATE measurements SET captured_at = '{text}' WHERE id = :id", id=measurement_id)
    items = get(zoned_api, f"/v1/sessions/{session_id}/measurements")["items"]
    assert [item["captured_at"] for item in items] == ["9999-12-31T23:59:59Z", "0001-01-01T00:00:00Z"]
    received = datetime.fromisoformat(items[0]["received_at"])
    assert abs(datetime.now(UTC) - received) < timedelta(minutes=10)
    assert [job.measurement_id for job in zoned_api.installation.queue.claim(8)] == ids
    taken = zoned_api.put_image(session_id, grey_png, captured_at="2026-01-31T12:00:00+05:45")
    assert taken.json()["captured_at"] == "2026-01-31T06:15:00Z"
    again = get(zoned_api, f"/v1/measurements/{taken.json()['id']}")
    assert again["captured_at"] == "2026-01-31T06:15:00Z"


@pytest.mark.postgres
def test_a_role_in_another_time_zone_reads_the_same(postgres_url: str) -> None:
    url = sa.make_url(postgres_url).update_query_dict(
        {"options": "-c TimeZone=Pacific/Apia -c DateStyle=SQL"}
    )
    database = Database(url.render_as_string(hide_password=False))
    with database.read() as records:
        assert records.scalar(sa.text("SHOW TimeZone")) == "UTC"
        assert records.scalar(sa.text("SELECT timestamptz '2026-01-31 12:00:00.5+14'")) == datetime(
            2026, 1, 30, 22, 0, 0, 500000, tzinfo=UTC
        )
    with database.read() as records:  # a transaction that was given up takes nothing with it
        assert records.scalar(sa.text("SHOW TimeZone")) == "UTC"
    database.dispose()


@pytest.mark.parametrize(
    "captured_at",
    [
        "9999-12-31T23:59:59Z",
        "1989-12-31T23:59:59Z",
        "0001-01-01T00:00:00+14:00",
        "2100-01-01T00:00:00-12:00",
    ],
)
def test_a_time_of_capture_out_of_bounds_is_refused_with_the_bounds(
    api: Any, grey_png: bytes, captured_at: str
) -> None:
    session_id = api.make_session()
    put = api.put_image(session_id, grey_png, captured_at=captured_at)
    form = api.client.post(
        f"/v1/sessions/{session_id}/images",
        files={"image": ("a.png", grey_png)},
        data={"pose_id": "P1", "captured_at": captured_at},
    )
    for response in (put, form):
        assert response.status_code == 422, response.text
        (error,) = response.json()["errors"]
        assert error["field"] == "captured_at"
    if not captured_at.startswith("0001"):
        assert "1990-01-01 and one day ahead" in error["message"]
    assert get(api, f"/v1/sessions/{session_id}/measurements")["items"] == []


def test_a_time_of_capture_may_be_one_day_ahead_and_no_more(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    now = datetime.now(UTC)
    ahead = (now + timedelta(hours=23)).isoformat()
    beyond = (now + timedelta(hours=25)).isoformat()
    assert api.put_image(session_id, grey_png, captured_at=beyond).status_code == 422
    assert api.put_image(session_id, grey_png, captured_at=ahead).status_code == 202
    assert api.put_image(session_id, grey_png, "P2", captured_at="1990-01-01T00:00:00Z").status_code == 202


def test_doctor_survives_a_time_of_arrival_that_cannot_be_read(any_api: Any, grey_png: bytes) -> None:
    _, (bad,) = upload(any_api, grey_png, "a")
    value = "'later'" if any_api.installation.database.is_sqlite else "'infinity'"
    damage(any_api, f"UPDATE measurements SET received_at = {value} WHERE id = :id", id=bad)
    results = list(database_checks.check(any_api.installation.settings))
    assert State.failed in [result.state for result in results]
