"""Events of robots over HTTP and on the command line: who may note and delete them, and what is refused."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from typer.testing import CliRunner, Result

from app.cli.main import app
from app.services.robots import events
from tests.support.service.service import Api, ApiMaker, assert_problem

EVENT = {"at": "2026-01-15T09:30:00+01:00", "note": "Belt of joint 5 replaced", "restarts_charts": True}


@pytest.fixture(scope="module")
def api(open_api: ApiMaker) -> Iterator[Api]:
    with open_api() as running:
        yield running


@pytest.fixture(scope="module")
def served(serve_api: ApiMaker) -> Iterator[Api]:
    with serve_api() as running:
        yield running


def path_of(robot_id: str) -> str:
    return f"/v1/robots/{robot_id}/events"


def test_events_are_noted_listed_audited_and_deleted(api: Api) -> None:
    path = path_of(api.make_robot())
    assert api.client.get(path).json() == {"items": [], "next_cursor": None, "warnings": []}
    response = api.client.post(path, json=EVENT, headers=api.key("upload"))
    assert response.status_code == 201, response.text
    event = response.json()
    assert response.headers["location"] == f"{path}/{event['id']}"
    assert event["at"] == "2026-01-15T08:30:00Z"
    assert (event["note"], event["restarts_charts"], event["made_by_name"]) == (EVENT["note"], True, "upload")
    second = api.client.post(path, json={"at": "2026-01-01T00:00:00Z", "note": "Greased"}).json()
    assert second["restarts_charts"] is False
    page = api.client.get(path, params={"limit": 1}).json()
    assert page["items"] == [event]
    assert api.client.head(path).status_code == 200
    assert api.client.get(path, params={"cursor": page["next_cursor"]}).json()["items"] == [second]
    entries = api.client.get("/v1/audit", params={"object_id": event["id"]}).json()["items"]
    assert [entry["action"] for entry in entries] == ["create_robot_event"]
    address = f"{path}/{event['id']}"
    assert_problem(api.client.delete(address, headers=api.key("upload")), 403, "insufficient_scope")
    assert api.client.delete(address).status_code == 204
    assert_problem(api.client.delete(address), 404, "event_not_found")
    assert api.client.get(path).json()["items"] == [second]


@pytest.mark.parametrize(
    "change",
    [
        {"at": "yesterday"},
        {"at": "2026-01-15"},
        {"at": "1970-01-01T00:00:00Z"},
        {"at": (datetime.now(UTC) + timedelta(days=2)).isoformat()},
        {"at": None},
        {"note": ""},
        {"note": "two\nlines"},
        {"note": "a" * 501},
        {"note": "hid\u202eden"},
        {"restarts_charts": "yes"},
        {"restart": True},
    ],
)
def test_what_is_no_event_is_refused(api: Api, change: dict[str, Any]) -> None:
    robot_id = api.make_robot()
    assert_problem(api.client.post(path_of(robot_id), json={**EVENT, **change}), 422, "invalid_request")
    assert api.client.get(path_of(robot_id)).json()["items"] == []


def test_events_belong_to_one_robot_and_go_with_it(api: Api) -> None:
    first, second = api.make_robot(), api.make_robot()
    event_id = api.client.post(path_of(first), json=EVENT).json()["id"]
    assert_problem(api.client.delete(f"{path_of(second)}/{event_id}"), 404, "event_not_found")
    assert_problem(api.client.delete(f"{path_of(first)}/{first}"), 404, "event_not_found")
    absent = f"rob_{'0' * 26}"
    assert_problem(api.client.post(path_of(absent), json=EVENT), 404, "robot_not_found")
    assert_problem(api.client.get(path_of(absent)), 404, "robot_not_found")
    assert api.client.delete(f"/v1/robots/{first}").status_code == 204
    with api.installation.database.read() as records:
        left = sa.text("SELECT count(*) FROM robot_events WHERE robot_id = :id")
        assert records.scalar(left, {"id": first}) == 0


def test_a_limited_key_reads_the_events_of_its_robot_alone(api: Api) -> None:
    own, other = api.make_robot(), api.make_robot()
    session_id = api.make_session(robot_id=own)
    for robot_id in (own, other):
        api.client.post(path_of(robot_id), json=EVENT)
    key = api.key("upload", session_ids=[session_id])
    assert len(api.client.get(path_of(own), headers=key).json()["items"]) == 1
    assert_problem(api.client.get(path_of(other), headers=key), 404, "robot_not_found")
    refused = api.client.post(path_of(own), json=EVENT, headers=key)
    assert_problem(refused, 403, "key_limited_to_sessions")


def test_a_robot_has_so_many_events_at_most(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "MAX_EVENTS", 1)
    path = path_of(api.make_robot())
    assert api.client.post(path, json=EVENT).status_code == 201
    assert_problem(api.client.post(path, json=EVENT), 409, "too_many_events")


def test_an_unreadable_event_is_named_and_hides_no_other(api: Api) -> None:
    path = path_of(api.make_robot())
    damaged, whole = (api.client.post(path, json=EVENT).json()["id"] for _ in range(2))
    with api.installation.database.write() as records:
        records.execute(sa.text("UPDATE robot_events SET at = 'half' WHERE id = :id"), {"id": damaged})
    found = api.client.get(path).json()
    assert [event["id"] for event in found["items"]] == [whole]
    assert damaged in found["warnings"][0]["detail"]
    assert api.client.delete(f"{path}/{damaged}").status_code == 204
    assert api.client.get(path).json()["warnings"] == []


def run(api: Api, *arguments: str, code: int = 0) -> Result:
    key = api.client.headers["authorization"].removeprefix("Bearer ")
    settings = {"GRIDPOSE_URL": str(api.client.base_url), "GRIDPOSE_KEY": key, "COLUMNS": "200"}
    done = CliRunner().invoke(app, ["robots", "events", *arguments], env=settings)
    assert done.exit_code == code, done.output
    return done


def ids(done: Result) -> list[str]:
    """What was printed; the application under test logs to the same stream."""
    return [line for line in done.stdout.splitlines() if line.startswith("eve_")]


def test_the_command_line_adds_lists_and_deletes(served: Api, tmp_path: Path) -> None:
    robot_id = served.make_robot("welder")
    (made,) = ids(run(served, "add", "welder", "Belt replaced", "--at", "2026-01-15", "--restarts-charts"))
    file = tmp_path / "events.csv"
    file.write_text("at,note,restarts\n2026-01-03T12:00:00+02:00,grease,\n2026-02-01,gearbox,yes\n", "utf-8")
    assert len(ids(run(served, "add", "welder", "--from", str(file)))) == 2
    listed = run(served, "list", "welder").stdout
    assert listed.index("grease") < listed.index("Belt replaced") < listed.index("gearbox")
    items = served.client.get(path_of(robot_id)).json()["items"]
    assert [one["restarts_charts"] for one in items] == [True, False, True]
    assert items[1]["at"] == "2026-01-03T10:00:00Z"
    assert "deleted" in run(served, "delete", "welder", made).stdout
    assert len(served.client.get(path_of(robot_id)).json()["items"]) == 2


@pytest.mark.parametrize(
    "arguments",
    [
        ("add", "welder"),
        ("add", "welder", "note", "--at", "yesterday"),
        ("add", "welder", "--from", "FILE"),
        ("add", "welder", "note", "--from", "FILE"),
        ("add", "welder", "--at", "2026-01-01", "--from", "FILE"),
    ],
)
def test_what_the_command_line_refuses(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    file = tmp_path / "events.csv"
    file.write_text("at,note,restarts\n2026-01-06,x,maybe\n", "utf-8")
    given = [str(file) if one == "FILE" else one for one in arguments]
    done = CliRunner().invoke(app, ["robots", "events", *given], env={"GRIDPOSE_URL": "http://127.0.0.1:1"})
    assert done.exit_code == 2, done.output
