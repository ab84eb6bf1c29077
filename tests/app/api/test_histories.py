"""A robot's history and the comparison of reports over HTTP: figures, forms, who sees them, what cannot be read."""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from app.analyses.history import charts_of_tests, read_history, summarise_reports
from app.api.schemas.documents.histories import ReportComparison, RobotHistory
from app.records.tables import ReportSummary
from app.services import robots
from app.services.qualifications import store_qualification
from tests.support.service.service import Api, ApiMaker, assert_problem, wait_until
from tests.support.sessions.filed_reports import content, store_filed

JOINT = {"a_mm": 100.0, "alpha_deg": 0.0, "d_mm": 0.0}
CSV = {"Accept": "text/csv"}
REPORTS = 8


@pytest.fixture(scope="module")
def api(open_api: ApiMaker) -> Iterator[Api]:
    with open_api() as running:
        yield running


def make_robot(api: Api) -> str:
    return str(api.client.post("/v1/robots", json={"name": "arm", "joints": [JOINT]}).json()["id"])


@pytest.fixture(scope="module")
def robot(api: Api) -> str:
    """A robot with eight reports, the last of which stands out, and an event."""
    robot_id = make_robot(api)
    store_filed(
        api,
        [
            content(k, robot=robot_id, rp_mm=0.05 + 0.001 * (k % 3) + 0.2 * (k == REPORTS))
            for k in range(1, REPORTS + 1)
        ],
    )
    summarise_reports(api.installation.database)
    event = {"at": "2020-01-04T12:00:00Z", "note": "greased"}
    assert api.client.post(f"/v1/robots/{robot_id}/events", json=event).status_code == 201
    return robot_id


def report(number: int) -> str:
    return f"rep_{number:026d}"


def test_a_history_has_figures_limits_events_and_points(api: Api, robot: str) -> None:
    response = api.client.get(f"/v1/robots/{robot}/history")
    assert response.status_code == 200, response.text
    found = RobotHistory.model_validate(response.json(), extra="forbid")
    assert (found.robot_id, found.sessions, found.warnings) == (robot, REPORTS, [])
    (test,) = found.tests
    assert (test.test_kind, test.sessions, test.load_kg, test.charted) == (
        "repeatability",
        REPORTS,
        5.0,
        True,
    )
    rp, floor = sorted(found.series, key=lambda one: one.figure)
    assert (rp.figure, rp.of, floor.figure) == ("RP_l", "all poses", "noise floor")
    assert rp.limits is not None
    assert not rp.limits.in_control
    assert floor.limits is not None
    assert floor.limits.in_control
    outside = [one.report_id for one in found.session_figures if one.outside]
    assert outside == [report(REPORTS)]
    assert [one.note for one in found.events] == ["greased"]
    same = api.client.get(f"/v1/robots/{robot}/history", headers={"If-None-Match": response.headers["etag"]})
    assert (same.status_code, same.content) == (304, b"")


@pytest.mark.parametrize(("table", "rows"), [(None, 2 * REPORTS), ("series", 2), ("tests", 1), ("events", 1)])
def test_each_table_of_a_history_is_csv_too(api: Api, robot: str, table: str | None, rows: int) -> None:
    query = {} if table is None else {"table": table}
    response = api.client.get(f"/v1/robots/{robot}/history", params=query, headers=CSV)
    assert response.headers["content-type"].startswith("text/csv")
    assert len(list(csv.DictReader(response.text.splitlines()))) == rows
    again = api.client.get(
        f"/v1/robots/{robot}/history",
        params=query,
        headers={**CSV, "If-None-Match": response.headers["etag"]},
    )
    assert again.status_code == 304


def test_a_history_is_of_one_kind_on_request(api: Api, robot: str) -> None:
    found = api.client.get(f"/v1/robots/{robot}/history", params={"kind": "kinematics"}).json()
    assert (found["tests"], found["series"], len(found["events"])) == ([], [], 1)


def test_charts_stand_over_dates_or_numbers(api: Api, robot: str) -> None:
    found = read_history(api.installation.database, robot, None)
    for axis, step in (("date", 1.0), ("session", 1.0)):
        charts = charts_of_tests(found.tests, found.events, axis)
        assert charts
        for chart in charts:
            assert chart["by_date"] == (axis == "date")
            assert np.diff(chart["places"]) == pytest.approx(step)  # a session a day
            assert all(chart["places"][0] < event < chart["places"][-1] for event in chart["events"])
    assert charts[0]["places"][0] == 1


def test_what_is_asked_wrongly_is_refused(api: Api, robot: str) -> None:
    path = f"/v1/robots/{robot}/history"
    assert_problem(api.client.get(path, params={"kind": "session"}), 422, "invalid_request")
    assert_problem(api.client.get(path, params={"kinds": "camera"}), 422, "invalid_request")
    assert_problem(api.client.get(path, params={"table": "poses"}), 422, "unknown_table")
    assert_problem(api.client.get(f"/v1/robots/rob_{'1' * 26}/history"), 404, "robot_not_found")
    assert_problem(api.client.get(f"/v1/robots/rob_{'1' * 26}/history.svg"), 404, "robot_not_found")
    assert_problem(api.client.get(f"{path}.svg", params={"kind": "camera"}), 409, "no_control_chart")
    assert_problem(api.client.get(path, headers=api.key("ingest")), 403, "insufficient_scope")


def test_two_reports_are_compared(api: Api, robot: str) -> None:
    path = f"/v1/reports/{report(REPORTS)}/comparison/{report(1)}"
    response = api.client.get(path)
    found = ReportComparison.model_validate(response.json(), extra="forbid")
    assert (found.earlier.report_id, found.later.report_id) == (report(1), report(REPORTS))
    assert (found.comparable, found.changed, found.reasons, found.not_stated) == (True, 3, [], [])
    assert "3 of 3 figures are larger" in found.conclusion
    rows = list(csv.DictReader(api.client.get(path, headers=CSV).text.splitlines()))
    assert [row["of"] for row in rows] == ["pose P1", "pose P2", "pose P3"]
    assert {"difference_interval_low", "ratio_interval_high"} <= set(rows[0])
    absent = f"rep_{'1' * 26}"
    assert_problem(api.client.get(f"/v1/reports/{report(1)}/comparison/{absent}"), 404, "report_not_found")
    assert_problem(api.client.get(f"/v1/reports/{absent}/comparison/{report(1)}"), 404, "report_not_found")
    assert_problem(api.client.get(f"/v1/reports/{report(1)}/comparison/no"), 404, "report_not_found")


def test_reports_that_are_not_comparable_say_why(api: Api, robot: str) -> None:
    store_filed(api, [content(400, robot=robot, conditions={"load_kg": 1.0, "temperature_c": None})])
    found = api.client.get(f"/v1/reports/{report(1)}/comparison/{report(400)}").json()
    assert not found["comparable"]
    assert "load" in found["reasons"][0]
    assert found["not_stated"] == ["the temperature (°C)"]
    assert "need not be the robot's" in found["conclusion"]
    with api.installation.database.write() as records:
        records.execute(sa.delete(ReportSummary).where(ReportSummary.report_id == report(400)))
        records.add(ReportSummary(report_id=report(400), robot_id=None, summary=None))


def test_a_report_that_is_not_made_or_no_report_is_refused(api: Api, robot: str) -> None:
    session_id = api.make_session()
    ordered = api.client.post(f"/v1/sessions/{session_id}/reports", json={"kind": "camera"}).json()["id"]
    refused = api.client.get(f"/v1/reports/{report(1)}/comparison/{ordered}")
    assert assert_problem(refused, 409)["code"] in (
        "report_not_made",
        "too_few_measurements",
        "no_usable_images",
    )
    store_filed(api, [content(401, robot=robot).replace(b'"rp_l_mm"', b'"other"')])
    assert_problem(api.client.get(f"/v1/reports/{report(1)}/comparison/{report(401)}"), 409, "row_unreadable")


def test_a_limited_key_sees_the_reports_of_its_sessions_alone(api: Api) -> None:
    robot_id = make_robot(api)
    own, other = (api.make_session(robot_id=robot_id) for _ in range(2))
    store_filed(
        api,
        [
            content(500, robot=robot_id, session=own),
            content(501, robot=robot_id, session=other),
        ],
    )
    summarise_reports(api.installation.database)
    key = api.key("read", session_ids=[own])
    found = api.client.get(f"/v1/robots/{robot_id}/history", headers=key).json()
    assert {one["session_id"] for one in found["session_figures"]} == {own}
    assert api.client.get(f"/v1/robots/{robot_id}/history").json()["sessions"] == 2
    compared = api.client.get(f"/v1/reports/{report(500)}/comparison/{report(501)}", headers=key)
    assert_problem(compared, 404, "report_not_found")
    stranger = api.key("read", session_ids=[api.make_session()])
    assert_problem(api.client.get(f"/v1/robots/{robot_id}/history", headers=stranger), 404, "robot_not_found")


def test_what_cannot_be_read_is_named_and_hides_nothing_else(api: Api) -> None:
    robot_id = make_robot(api)
    session_id = api.make_session(robot_id=robot_id)
    store_filed(
        api,
        [
            content(600, robot=robot_id),
            content(601, robot=robot_id),
            content(602, robot=robot_id, session=session_id).replace(b'"rp_l_mm"', b'"other"'),
        ],
    )
    path = f"/v1/robots/{robot_id}"
    event = api.client.post(f"{path}/events", json={"at": "2026-01-01T00:00:00Z", "note": "x"}).json()["id"]
    while summarise_reports(api.installation.database):
        pass
    with api.installation.database.write() as records:
        records.execute(
            sa.text("UPDATE report_summaries SET summary = '{half' WHERE report_id = :id"),
            {"id": report(601)},
        )
        records.execute(sa.text("UPDATE robot_events SET at = 'half' WHERE id = :id"), {"id": event})
    found = api.client.get(f"{path}/history").json()
    assert {one["report_id"] for one in found["session_figures"]} == {report(600)}
    assert {one["code"] for one in found["warnings"]} == {"row_unreadable"}
    named = " ".join(one["detail"] for one in found["warnings"])
    assert all(one in named for one in (report(601), report(602), event))
    assert found["events"] == []


def test_qualifications_are_in_the_history(api: Api) -> None:
    robot_id = make_robot(api)
    session_id = api.make_session(robot_id=robot_id)
    figures = {"worst_error_mm": 0.01, "scale_ppm": -3.5, "probing_scatter_mm": 0.02}
    analysis = {**figures, "decision": None, "maximum_permissible_error_mm": None}
    for _ in range(5):
        with api.installation.database.write() as records:
            store_qualification(records, session_id, analysis, valid_days=365, camera_name="C-7")
    found = api.client.get(f"/v1/robots/{robot_id}/history", params={"kind": "qualification"}).json()
    RobotHistory.model_validate(found, extra="forbid")
    assert {(one["figure"], one["sessions"], one["unit"]) for one in found["series"]} == {
        ("worst error", 5, "mm"),
        ("scale", 5, "ppm"),
        ("probing scatter", 5, "mm"),
    }
    (test,) = found["tests"]
    assert (test["test_kind"], test["source"], test["camera_name"]) == ("qualification", None, "C-7")
    known = {one["id"] for one in api.client.get("/v1/qualifications").json()["items"]}
    assert {one["qualification_id"] for one in found["session_figures"]} <= known
    assert {one["report_id"] for one in found["session_figures"]} == {None}


def test_a_history_that_is_too_long_says_so(api: Api, robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robots.history, "MAX_REPORTS", 3)
    found = api.client.get(f"/v1/robots/{robot}/history").json()
    assert [one["code"] for one in found["warnings"]] == ["history_truncated"]
    assert {one["report_id"] for one in found["session_figures"]} == {report(REPORTS - k) for k in range(3)}


def test_reports_of_earlier_versions_are_read_after_a_restart(open_api: ApiMaker, tmp_path: Any) -> None:
    with open_api(tmp_path / "data") as before:
        robot_id = make_robot(before)
        store_filed(before, [content(k, robot=robot_id) for k in range(700, 745)])
        waiting = before.client.get(f"/v1/robots/{robot_id}/history").json()
        assert [one["code"] for one in waiting["warnings"]] == ["history_incomplete"]
    with open_api(tmp_path / "data") as after:

        def found() -> dict[str, Any]:
            document: dict[str, Any] = after.client.get(f"/v1/robots/{robot_id}/history").json()
            return document

        wait_until(lambda: not found()["warnings"], what="all reports are read")
        assert found()["sessions"] == 45


@pytest.mark.slow
def test_a_history_of_a_thousand_sessions_costs_little_more_than_its_text(api: Api) -> None:
    """Fifteen hundredths of a second on a machine that reads its JSON in one."""
    robot_id = make_robot(api)
    store_filed(
        api, [content(k, robot=robot_id, poses=5, rp_mm=0.05 + 0.001 * (k % 7)) for k in range(1000, 2000)]
    )
    while summarise_reports(api.installation.database):
        pass
    took, read = [], []
    for _ in range(7):
        began = time.process_time()  # what others compute on this machine does not count
        response = api.client.get(f"/v1/robots/{robot_id}/history")
        answered = time.process_time()
        found = json.loads(response.content)
        took.append(answered - began)
        read.append(time.process_time() - answered)
    assert found["sessions"] == 1000
    ratio = sorted(took)[3] / sorted(read)[3]
    print(
        f"history of 1000 sessions: {sorted(took)[3] * 1e3:.0f} ms of processor time, {ratio:.1f} times its text"
    )
    assert ratio < 30.0
