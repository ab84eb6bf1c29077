"""Event streams through a real server: how many, and that each ends with its client or its key."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx2
import pytest

from app.api import session_events
from app.api.event_streams import PER_KEY
from app.errors import Unavailable
from app.records.tables import ApiKey
from app.services.keys import NewKey, create_key, revoke_key

ENDS_WITHIN_S = 120.0
"""Two seconds on an idle machine."""


@pytest.fixture(scope="module")
def served(serve_api: Any) -> Iterator[Any]:
    with serve_api() as api:
        yield api


def follow(stack: ExitStack, api: Any, session_id: str, key: NewKey) -> tuple[httpx2.Response, Iterator[str]]:
    """Open a stream and return it, read to its first event, with its further lines."""
    client = stack.enter_context(httpx2.Client(base_url=api.client.base_url, timeout=ENDS_WITHIN_S))
    response = stack.enter_context(
        client.stream(
            "GET",
            f"/v1/sessions/{session_id}/events",
            headers={"Authorization": f"Bearer {key.secret_key}"},
        )
    )
    lines = response.iter_lines()
    if response.status_code == 200:
        assert next(lines) == "event: progress"
    return response, lines


def expire(api: Any, key: NewKey) -> None:
    with api.installation.database.write() as records:
        records.get(ApiKey, key.key.id).expires_at = datetime.now(UTC) - timedelta(seconds=1)


def revoke(api: Any, key: NewKey) -> None:
    revoke_key(api.installation, key.key.id)


@pytest.mark.parametrize("end", [revoke, expire])
def test_a_stream_ends_when_its_key_is_no_longer_valid(served: Any, end: Any) -> None:
    session_id = served.make_session()
    kept, lost = (create_key(served.installation, name, "read") for name in ("kept", "lost"))
    with ExitStack() as stack:
        _, others = follow(stack, served, session_id, kept)
        _, lines = follow(stack, served, session_id, lost)
        end(served, lost)
        assert "event: deleted" not in list(lines), "it ended, and for no other reason"
        until_open(served, 1)
        assert next(others).startswith("id: ")
    until_open(served, 0)


def test_a_key_has_so_many_streams_and_one_that_is_closed_makes_room(served: Any) -> None:
    session_id = served.make_session()
    key, other = (create_key(served.installation, name, "read") for name in ("key", "other"))
    with ExitStack() as stack:
        one = ExitStack()
        held = [follow(one, served, session_id, key)]
        for _ in range(PER_KEY - 1):
            held.append(follow(stack, served, session_id, key))
        assert [response.status_code for response, _ in held] == [200] * PER_KEY
        refused, _ = follow(stack, served, session_id, key)
        refused.read()
        assert (refused.status_code, refused.json()["code"]) == (503, "too_many_streams")
        assert refused.json()["advice"]
        held.append(follow(stack, served, session_id, other))
        assert held[-1][0].status_code == 200
        one.close()
        until_open(served, PER_KEY)
        held.append(follow(stack, served, session_id, key))
        assert held[-1][0].status_code == 200
    until_open(served, 0)


def test_a_stream_of_a_deleted_session_says_so_and_is_free(served: Any) -> None:
    session_id = served.make_session()
    key = create_key(served.installation, "key", "read")
    with ExitStack() as stack:
        _, lines = follow(stack, served, session_id, key)
        assert served.client.delete(f"/v1/sessions/{session_id}").status_code == 204
        assert "event: deleted" in list(lines)
    until_open(served, 0)


@pytest.mark.slow
def test_a_stream_outlasts_a_database_that_is_busy(served: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    looks, look = [], session_events._look

    def busy_at_first(*arguments: Any) -> Any:
        looks.append(arguments)
        if len(looks) < 3:
            raise Unavailable("The database is busy.", code="database_unavailable")
        return look(*arguments)

    monkeypatch.setattr(session_events, "_look", busy_at_first)
    session_id = served.make_session()
    key = create_key(served.installation, "key", "read")
    with ExitStack() as stack:
        _, lines = follow(stack, served, session_id, key)
        found = [next(lines) for _ in range(6)]
        assert found.count(": still here") == 2
        assert served.client.delete(f"/v1/sessions/{session_id}").status_code == 204
        assert "event: deleted" in list(lines)
    until_open(served, 0)


def until_open(api: Any, count: int) -> None:
    """Wait until so many streams are open; the service counts one off a little after its client sees the end."""
    deadline = time.monotonic() + ENDS_WITHIN_S
    while api.service.streams.count() > count:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert api.service.streams.count() == count
