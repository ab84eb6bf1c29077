"""Events of a session: one for each change of a measurement's status, and nothing is lost between two streams."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.api import session_events
from app.records.tables import Measurement
from app.services.following import changes
from app.services.keys import create_key, revoke_key
from tests.support.environment.postgres import EITHER_DATABASE, new_database
from tests.support.image.images import small_image
from tests.support.service.events import Event, read_events
from tests.support.service.service import Api, ApiMaker

COUNTS = dict.fromkeys(("queued", "running", "succeeded", "failed", "duplicates"), 0)


@contextmanager
def followed(api: Api, session_id: str, last: str | bytes | None = None) -> Iterator[Iterator[Event]]:
    """Open a stream that ends with its key."""
    key = create_key(api.installation, "follower", "read")
    headers: dict[str, Any] = {"Authorization": f"Bearer {key.secret_key}"}
    if last is not None:
        headers["Last-Event-ID"] = last
    with api.client.stream("GET", f"/v1/sessions/{session_id}/events", headers=headers) as response:
        assert response.status_code == 200
        events = read_events(response)
        try:
            yield events
        finally:
            revoke_key(api.installation, key.key.id)
        assert [event.name for event in events] == [], "it ends when its key is revoked"


def put(api: Api, session_id: str, *numbers: int) -> list[str]:
    return [api.put_image(session_id, small_image(n), f"P{n}").json()["id"] for n in numbers]


def set_status(api: Api, measurement_id: str, status: str) -> None:
    """Change a status as anything may that writes to the database."""
    with api.installation.database.write() as records:
        records.execute(
            sa.update(Measurement).where(Measurement.id == measurement_id).values(status=status),
            execution_options={"synchronize_session": False},
        )


def next_changes(events: Iterator[Event], count: int) -> list[tuple[str, str]]:
    """Return the measurement and status of the next events, none of which is of another kind."""
    found = [next(events) for _ in range(count)]
    assert {event.name for event in found} == {"measurement"}
    return [(event.data["measurement_id"], event.data["status"]) for event in found]


def test_every_change_of_a_measurement_is_an_event(any_api: Api) -> None:
    session_id = any_api.make_session()
    with followed(any_api, session_id) as events:
        first = next(events)
        assert first.name == "progress"
        assert first.data == {"session_id": session_id, "counts": COUNTS, "pending": 0}
        (sent,) = put(any_api, session_id, 1)
        for status in ("queued", "running", "succeeded", "queued"):  # the last one is a retry
            if status != "queued" or any_api.measurement(sent)["status"] != "queued":
                set_status(any_api, sent, status)
            event = next(events)
            assert event.name == "measurement"
            assert event.data == {
                "measurement_id": sent,
                "pose_id": "P1",
                "status": status,
                "counts": {**COUNTS, status: 1},
            }
            assert event.id


def test_a_stream_goes_on_after_the_last_event_received(any_api: Api) -> None:
    session_id, other = any_api.make_session(), any_api.make_session()
    one, two, three = put(any_api, session_id, 1, 2, 3)
    with followed(any_api, session_id) as events:
        at_connection = next(events).id
        set_status(any_api, two, "running")
        assert next_changes(events, 1) == [(two, "running")]
        set_status(any_api, one, "running")
        last = next(events).id
    put(any_api, other, 1)
    set_status(any_api, one, "failed")
    (four,) = put(any_api, session_id, 4)
    set_status(any_api, two, "queued")
    set_status(any_api, two, "running")
    missed = [(one, "failed"), (four, "queued"), (two, "running")]
    with followed(any_api, session_id, last) as events:
        first = next(events)
        assert (first.name, first.id) == ("progress", last), "who leaves now has missed as much"
        assert first.data["counts"] == {**COUNTS, "queued": 2, "running": 1, "failed": 1}
        assert next_changes(events, 3) == missed
        set_status(any_api, three, "running")
        assert next_changes(events, 1) == [(three, "running")], "none comes twice, and those of others do not"
    with followed(any_api, session_id, at_connection) as events:
        next(events)
        assert next_changes(events, 4) == [*missed, (three, "running")]


def test_what_was_missed_comes_in_order_however_much_it_is(
    any_api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(changes, "AT_ONCE", 2)
    session_id = any_api.make_session()
    with followed(any_api, session_id) as events:
        last = next(events).id
    sent = put(any_api, session_id, *range(1, 8))
    with any_api.installation.database.write() as records:  # in one statement, which may give all one number
        records.execute(
            sa.update(Measurement).values(status="running"), execution_options={"synchronize_session": False}
        )
    with followed(any_api, session_id, last) as events:
        next(events)
        found = [next(events) for _ in sent]
        assert sorted(event.data["measurement_id"] for event in found) == sent
    with followed(any_api, session_id, found[3].id) as events:
        next(events)
        assert [next(events) for _ in range(3)] == found[4:]


Reopen = Callable[[], AbstractContextManager[Api]]


@pytest.fixture(params=EITHER_DATABASE)
def reopen(
    request: pytest.FixtureRequest, empty_data_dir: Path, open_api: ApiMaker, tmp_path: Path
) -> Iterator[Reopen]:
    """Return what runs another application on the same installation."""
    if request.param == "sqlite":
        shutil.copytree(empty_data_dir, tmp_path / "data")
        yield lambda: open_api(tmp_path / "data")
        return
    folder, template = request.getfixturevalue("migrated_postgres")
    shutil.copytree(folder, tmp_path / "data")
    with new_database(template) as url:
        yield lambda: open_api(tmp_path / "data", database_url=url)


def test_a_restart_loses_nothing(reopen: Reopen) -> None:
    with reopen() as api:
        session_id = api.make_session()
        one, two = put(api, session_id, 1, 2)
        with followed(api, session_id) as events:
            last = next(events).id
        set_status(api, two, "running")
    with reopen() as api:
        set_status(api, one, "running")
        with followed(api, session_id, last) as events:
            assert next(events).data["counts"]["running"] == 2
            assert next_changes(events, 2) == [(two, "running"), (one, "running")]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "-",
        "7",
        "-1-",
        "1-mea_x",
        "1-mea_01m8gtsj6kznjkdsq2fpmgw4v2' OR 1=1",
        f"{10**16}-",
        f"{10**16 - 1}-",
        f"{10**30}-mea_01m8gtsj6kznjkdsq2fpmgw4v2",
        "\u0661-".encode(),
        b"\xff\xfe",
        "9" * 5000,
    ],
)
def test_an_id_that_no_event_had_begins_with_the_present(any_api: Api, text: str | bytes) -> None:
    session_id = any_api.make_session()
    _, two = put(any_api, session_id, 1, 2)
    with followed(any_api, session_id, text) as events:
        assert next(events).data["counts"] == {**COUNTS, "queued": 2}
        set_status(any_api, two, "running")
        assert next_changes(events, 1) == [(two, "running")]


def test_counts_that_change_otherwise_come_as_progress(any_api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_events, "RECOUNT_S", 0.0)
    session_id = any_api.make_session()
    one, two = put(any_api, session_id, 1, 2)
    with followed(any_api, session_id) as events:
        next(events)
        set_status(any_api, two, "failed")
        last = next(events).id
        assert any_api.client.delete(f"/v1/measurements/{two}").status_code == 204
        event = next(events)
        assert (event.name, event.data["counts"]) == ("progress", {**COUNTS, "queued": 1})
    with followed(any_api, session_id, last) as events:  # the event of a measurement that is gone
        next(events)
        set_status(any_api, one, "running")
        assert next_changes(events, 1) == [(one, "running")]
        assert any_api.client.delete(f"/v1/sessions/{session_id}").status_code == 204
        assert [(event.name, event.data) for event in events] == [("deleted", {"session_id": session_id})]


def test_a_session_that_is_not_there_has_no_events(any_api: Api) -> None:
    session_id = any_api.make_session()
    any_api.client.delete(f"/v1/sessions/{session_id}")
    answer = any_api.client.get(f"/v1/sessions/{session_id}/events", headers={"Last-Event-ID": "x"})
    assert answer.status_code == 404
