"""Many who ask at once, clients that leave, and questions that cost too much: through a real server."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx2
import pytest

from app.analyses import service as desk
from app.analyses.computations import compute
from app.analyses.service import PLACES
from tests.support.sessions.stored_sessions import shoot

MIB = 1024 * 1024
ESTIMATORS = ("pooled", "pooled_free_focal", "per_image", "per_image_fixed_pp", "given")


def gate_of(url: str) -> Path:
    return Path(url.removeprefix("sqlite:///")).parent / "gate"


def gated(url: str, analysis: str, session_id: str, settings: Any) -> Any:
    """Run in a side process: note that it runs, wait until the session's gate is open, then compute."""
    gate = gate_of(url)
    gate.mkdir(exist_ok=True)
    (gate / f"{session_id}.{analysis}.{settings.get('estimator')}.{time.monotonic_ns()}").touch()
    while not (gate / session_id).exists():
        time.sleep(0.01)
    return compute(url, analysis, session_id, settings)


def greedy(url: str, analysis: str, session_id: str, settings: Any) -> Any:
    """Run in a side process: note that it runs, and take more memory than any analysis may."""
    gate = gate_of(url)
    gate.mkdir(exist_ok=True)
    (gate / f"{session_id}.{analysis}").touch()
    kept = bytearray(1500 * MIB)
    kept[::4096] = b"x" * len(kept[::4096])
    time.sleep(300.0)


class Desk:
    """The served application, its gates, and sessions to ask about."""

    def __init__(self, api: Any, store: Callable[..., list[str]]) -> None:
        self.api, self._store = api, store
        self.gate = gate_of(api.installation.database.url.render_as_string(hide_password=False))

    def session(self) -> str:
        session_id: str = self.api.make_session()
        self._store(self.api, session_id, shoot(cycles=2))
        return session_id

    def open(self, session_id: str) -> None:
        self.gate.mkdir(exist_ok=True)
        (self.gate / session_id).touch()

    def started(self, session_id: str) -> int:
        return len(list(self.gate.glob(f"{session_id}.*")))

    def get(self, session_id: str, key: Any, estimator: str = "pooled", analysis: str = "intrinsics") -> Any:
        return httpx2.get(
            f"{self.api.client.base_url}/v1/sessions/{session_id}/{analysis}",
            params={"estimator": estimator},
            headers=key,
            timeout=120.0,
        )

    def leaving(self, session_id: str, key: Any, estimator: str = "pooled") -> socket.socket:
        """Ask, and return the connection, to be closed before the answer."""
        base = self.api.client.base_url
        connection = socket.create_connection((base.host, base.port))
        request = (
            f"GET /v1/sessions/{session_id}/intrinsics?estimator={estimator} HTTP/1.1\r\nHost: test\r\n"
            f"Authorization: {key['Authorization']}\r\n\r\n"
        )
        connection.sendall(request.encode())
        return connection

    def until(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 120.0
        while not condition():
            assert time.monotonic() < deadline, what
            time.sleep(0.01)


@pytest.fixture(scope="module")
def served(serve_api: Any) -> Iterator[Any]:
    with serve_api() as api:
        yield api


@pytest.fixture
def slow(served: Any, store: Any, monkeypatch: pytest.MonkeyPatch) -> Desk:
    """Every analysis waits for its session's gate."""
    monkeypatch.setattr(desk, "compute", gated)
    return Desk(served, store)


@pytest.mark.slow
def test_one_key_cannot_take_all_places_nor_all_processes(slow: Desk) -> None:
    flooding, other = slow.api.key("read"), slow.api.key("read")
    sessions = [slow.session() for _ in range(PLACES // len(ESTIMATORS) + 1)]
    questions = [(session, one) for session in sessions for one in ESTIMATORS][: PLACES // 2]
    with ThreadPoolExecutor(PLACES) as pool:
        waiting = [pool.submit(slow.get, session, flooding, one) for session, one in questions]
        slow.until(lambda: sum(slow.api.service.analyses.counts()) == PLACES // 2, "all asked")
        refused = slow.get(sessions[0], flooding, analysis="repeatability")
        assert (refused.status_code, refused.json()["code"]) == (503, "busy")
        assert int(refused.headers["retry-after"]) > 0
        free = slow.session()
        slow.open(free)
        assert slow.get(free, other).status_code == 200
        assert not any(one.done() for one in waiting), "the flood is still waiting"
        for session in sessions:
            slow.open(session)
        # An estimator may refuse such a session; none is lost.
        assert {one.result().status_code for one in waiting} <= {200, 409}


def test_the_analyses_of_a_client_that_leaves_are_stopped_and_dropped(slow: Desk) -> None:
    key, session = slow.api.key("read"), slow.session()
    running, queued = slow.leaving(session, key), slow.leaving(session, key, "per_image")
    slow.until(lambda: slow.api.service.analyses.counts() == (1, 1), "one runs, one waits")
    slow.until(lambda: slow.started(session) == 1, "it runs")
    for connection in (queued, running):
        connection.close()
    slow.until(lambda: slow.api.service.analyses.counts() == (0, 0), "both are gone")
    assert slow.started(session) == 1, "what waited was never begun"
    slow.open(session)
    assert slow.get(session, key).status_code == 200


def test_who_asks_the_same_shares_one_computation_which_outlives_one_that_leaves(slow: Desk) -> None:
    keys, session = [slow.api.key("read") for _ in range(3)], slow.session()
    with ThreadPoolExecutor(2) as pool:
        first = slow.leaving(session, keys[0])
        slow.until(lambda: slow.started(session) == 1, "it runs")
        others = [pool.submit(slow.get, session, key) for key in keys[1:]]
        slow.until(lambda: clients(slow) == 3, "all three wait for it")
        first.close()
        slow.until(lambda: clients(slow) == 2, "one has left")
        slow.open(session)
        answers = [one.result() for one in others]
    assert [answer.status_code for answer in answers] == [200, 200]
    assert answers[0].content == answers[1].content
    assert slow.started(session) == 1


def clients(slow: Desk) -> int:
    return sum(asked.clients for asked in tuple(slow.api.service.analyses._under_way.values()))


def test_a_refusal_is_computed_once_until_the_session_changes(
    served: Any, store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = served.make_session()
    url = f"/v1/sessions/{session}/intrinsics"
    first = served.client.get(url)
    assert first.status_code == 409
    with monkeypatch.context() as broken:
        broken.delattr(desk, "compute")
        assert served.client.get(url).json() == first.json()
    store(served, session, shoot(cycles=2))
    assert served.client.get(url).status_code == 200


@pytest.mark.slow
def test_what_takes_too_long_is_stopped_and_not_tried_again_at_once(
    serve_api: Any, store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(desk, "compute", gated)
    with serve_api(analysis_timeout_s=0.5) as api:
        slow = Desk(api, store)
        key, session = api.key("read"), slow.session()
        for _ in range(2):
            answer = slow.get(session, key)
            assert (answer.status_code, answer.json()["code"]) == (503, "analysis_interrupted")
            assert int(answer.headers["retry-after"]) > 60
            assert "GRIDPOSE_ANALYSIS_TIMEOUT_S" in answer.json()["advice"]
        assert slow.started(session) == 1
        store(api, session, shoot(seed=2, cycles=1))
        assert slow.get(session, key).status_code == 503
        assert slow.started(session) == 2, "other inputs are another question"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc to see memory")
def test_what_takes_too_much_memory_is_refused_by_name_and_not_tried_again_at_once(
    serve_api: Any, store: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(desk, "compute", greedy)
    with serve_api(analysis_memory_bytes=700 * MIB) as api:
        slow = Desk(api, store)
        key, session = api.key("read"), slow.session()
        for _ in range(2):
            answer = slow.get(session, key)
            assert (answer.status_code, answer.json()["code"]) == (409, "analysis_too_large")
            assert "GRIDPOSE_ANALYSIS_MEMORY_BYTES" in answer.json()["advice"]
        assert slow.started(session) == 1
