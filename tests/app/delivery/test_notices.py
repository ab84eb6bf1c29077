"""What is noted: reports, changed verdicts, alarms, measured sessions; figures for monitoring."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
import sqlalchemy as sa

from app.analyses.history import latest, summarise_reports
from app.delivery.measured import MeasuredSessions
from app.records import ids
from app.records.tables import Measurement, Notice, Report
from app.services import notices, reports
from app.services.qualifications import store_qualification
from tests.support.service.service import Api
from tests.support.sessions.filed_reports import content, store_filed


def noted(api: Api, kind: str) -> list[dict[str, Any]]:
    with api.installation.database.read() as records:
        rows = records.scalars(sa.select(Notice).where(Notice.type == kind).order_by(Notice.id)).all()
        return [row.data for row in rows]


def file_and_note(api: Api, robot_id: str, number: int, *, verdict: str = "robot", **changes: Any) -> None:
    """A report as it is saved: its rows, its summary and its notice."""
    document = json.loads(content(number, robot=robot_id, **changes))
    for pose in document["analyses"]["repeatability"]["poses"]:
        pose["verdict"] = verdict
    document["analyses"]["repeatability"]["acceptance"] = {"decision": "pass"}
    store_filed(api, [json.dumps(document).encode()])
    summarise_reports(api.installation.database)
    with api.installation.database.write() as records:
        data = {"report_id": document["report_id"], "kind": "repeatability", "robot_id": robot_id}
        about = {"session_id": document["subject"]["session"]["id"], "session_name": f"week {number}"}
        notices.note(records, "report.ready", {**data, **about})


def test_alarms_are_noted_once_and_changed_verdicts_with_their_report(api: Api) -> None:
    api.service.delivery.stop()
    robot_id = api.make_robot()
    for number in range(1, 9):
        file_and_note(api, robot_id, number, rp_mm=0.05 + 0.001 * (number % 3))
        while api.service.delivery.examine():
            pass
    assert noted(api, "robot.alarm") == []
    assert noted(api, "verdict.changed") == []
    for number in range(9, 17):
        file_and_note(api, robot_id, number, rp_mm=0.2, verdict="not_steady")
        while api.service.delivery.examine():
            pass
    (alarm,) = noted(api, "robot.alarm")
    assert (alarm["robot_id"], alarm["robot_name"]) == (robot_id, "arm")
    assert (alarm["of"], alarm["figure"], alarm["direction"]) == ("all poses", "RP_l", "up")
    assert "week 9" in alarm["sentence"]
    (changed,) = noted(api, "verdict.changed")
    assert (changed["report_id"], changed["earlier_report_id"]) == (f"rep_{9:026d}", f"rep_{8:026d}")
    assert {one["of"] for one in changed["changes"]} == {"pose P1", "pose P2", "pose P3"}
    assert {(one["before"], one["after"]) for one in changed["changes"]} == {("robot", "not_steady")}


def test_sessions_that_are_not_comparable_change_no_verdict(api: Api) -> None:
    api.service.delivery.stop()
    robot_id = api.make_robot()
    file_and_note(api, robot_id, 1)
    file_and_note(api, robot_id, 2, verdict="not_steady", conditions={"load_kg": 0.0})
    while api.service.delivery.examine():
        pass
    assert noted(api, "verdict.changed") == []
    assert len(noted(api, "report.ready")) == 2


def test_numbers_follow_one_another_and_nothing_is_numbered_twice(api: Api) -> None:
    api.service.delivery.stop()
    with api.installation.database.write() as records:
        for _ in range(120):
            notices.note(records, "report.failed", {})
        assert notices.note(records, "robot.alarm", {}, about=("a", "b")) is not None
        assert notices.note(records, "robot.alarm", {}, about=("a", "b")) is None
    while api.service.delivery.examine():
        pass
    with api.installation.database.read() as records:
        numbers = records.scalars(sa.select(Notice.number).order_by(Notice.id)).all()
    assert list(numbers) == list(range(1, 122))


def test_reports_and_qualifications_are_noted_in_their_own_transaction(api: Api) -> None:
    api.service.delivery.stop()
    robot_id = api.make_robot()
    session_id = api.make_session(robot_id=robot_id)
    analysis = {
        **dict.fromkeys(("worst_error_mm", "scale_ppm", "probing_scatter_mm"), 0.01),
        "decision": "fail",
        "maximum_permissible_error_mm": 0.005,
    }
    new = reports.NewReport(kind="camera", title=None, signatories=[], paper="a4")
    with api.installation.database.write() as records:
        store_qualification(records, session_id, analysis, valid_days=30, camera_name=None)
        ordered = reports.order_report(records, session_id, new).report.id
        records.flush()
        records.execute(sa.update(Report).values(status="running"))
        reports.save_failure(records, ordered, "too_few_images", "Too few.", None)
        reports.save_failure(records, ordered, "too_few_images", "Too few.", None)
    (qualification,) = noted(api, "qualification.made")
    assert (qualification["decision"], qualification["robot_id"]) == ("fail", robot_id)
    (failed,) = noted(api, "report.failed")
    assert (failed["report_id"], failed["code"]) == (ordered, "too_few_images")
    assert (failed["session_id"], failed["session_name"]) == (session_id, "session")


def finish(api: Api, status: str = "succeeded") -> None:
    with api.installation.database.write() as records:
        records.execute(sa.update(Measurement).values(status=status, failure_code=None))


def test_a_session_is_measured_when_nothing_waits_and_nothing_comes(api: Api, grey_png: bytes) -> None:
    api.service.delivery.stop()
    session_id = api.make_session()
    looking, now = MeasuredSessions(api.installation.database), datetime.now(UTC)
    looking.look(now)
    assert api.put_image(session_id, grey_png).status_code == 202
    for later in (1, 90, 300):
        assert looking.look(now + timedelta(seconds=later)) == 0, "an image waits"
    finish(api, "failed")
    again = MeasuredSessions(api.installation.database)  # after a restart
    assert again.look(now + timedelta(seconds=30)) == 0, "another image may come"
    assert again.look(now + timedelta(seconds=400)) == 1
    assert again.look(now + timedelta(seconds=500)) == 0
    (found,) = noted(api, "session.measured")
    assert (found["session_id"], found["succeeded"], found["failed"]) == (session_id, 0, 1)


def test_a_session_is_measured_although_the_clock_was_ahead_once(
    api: Api, grey_png: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ids go on from those made then, and lie ahead of the clock for as long as it was."""
    api.service.delivery.stop()
    looking, now = MeasuredSessions(api.installation.database), datetime.now(UTC)
    ahead = now + timedelta(days=365)
    monkeypatch.setattr(ids, "_last", 0)  # other tests' ids stay in time
    ids.follow([ids.least_id("mea", ahead)])
    assert looking.look(ahead) == 0
    session_ids = [api.make_session(), api.make_session()]
    for session_id, received_at in zip(session_ids, (ahead, now), strict=True):
        stored = api.put_image(session_id, grey_png).json()["id"]
        with api.installation.database.write() as records:
            records.execute(
                sa.update(Measurement).where(Measurement.id == stored).values(received_at=received_at)
            )
    finish(api)
    for moment in (ahead + timedelta(seconds=1), now, now + timedelta(seconds=30)):
        assert looking.look(moment) == 0, "another image may come"
    assert looking.look(now + timedelta(seconds=90)) == 2
    assert {found["session_id"] for found in noted(api, "session.measured")} == set(session_ids)


def test_images_that_came_and_were_measured_between_two_looks_are_not_missed(
    api: Api, grey_png: bytes
) -> None:
    api.service.delivery.stop()
    looking, now = MeasuredSessions(api.installation.database), datetime.now(UTC)
    looking.look(now)
    session_id, deleted = api.make_session(), api.make_session()
    for one in (session_id, deleted):
        assert api.put_image(one, grey_png).status_code == 202
    finish(api)
    for later in (15, 50):
        assert looking.look(now + timedelta(seconds=later)) == 0, "another image may come"
    assert api.client.delete(f"/v1/sessions/{deleted}").status_code == 204
    assert looking.look(now + timedelta(seconds=120)) == 1
    assert [one["session_id"] for one in noted(api, "session.measured")] == [session_id]


def test_the_latest_figures_of_robots_are_metrics(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = api.make_robot("first"), api.make_robot('sec"ond')
    store_filed(api, [content(1, robot=first, rp_mm=0.09), content(2, robot=first, rp_mm=0.07)])
    store_filed(api, [content(3, robot=second, rp_mm=0.05)])
    summarise_reports(api.installation.database)
    lines = api.client.get("/metrics").text.splitlines()

    def value(name: str, robot: str) -> float:
        (line,) = (one for one in lines if one.startswith(f'gridpose_robot_{name}{{robot="{robot}"'))
        return float(line.rpartition(" ")[2])

    assert value("repeatability_worst_mm", "first") == 0.07
    assert value("repeatability_worst_mm", 'sec\\"ond') == 0.05
    assert value("noise_floor_worst_mm", "first") == 0.004
    assert value("measured_timestamp_seconds", "first") == datetime(2020, 1, 3, tzinfo=UTC).timestamp()
    assert not [one for one in lines if one.startswith("gridpose_robot_accuracy_worst_mm{")]
    assert "gridpose_robots_not_shown 0.0" in lines
    assert 'gridpose_webhook_deliveries{status="waiting"} 0.0' in lines
    monkeypatch.setattr(latest, "MAX_ROBOTS", 1)
    lines = api.client.get("/metrics").text.splitlines()
    assert "gridpose_robots_not_shown 1.0" in lines
    assert len([one for one in lines if one.startswith("gridpose_robot_repeatability_worst_mm{")]) == 1
    assert value("repeatability_worst_mm", 'sec\\"ond') == 0.05
