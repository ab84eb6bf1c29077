"""Large JSON bodies: the event loop goes on meanwhile, and nothing of the contract is given up for it."""

from __future__ import annotations

import asyncio
import gc
import json
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import ExitStack
from typing import Any

import httpx2
import pytest

from app.api import json_body
from app.api.json_body import INLINE_LIMIT
from app.api.schemas.measured_poses import MAX_MEASURED_POSES
from app.api.schemas.measurements import MAX_IMAGE_NAMES
from app.api.schemas.poses import MAX_POSES
from app.services.measured_poses import MAX_IN_SESSION
from tests.support.service.service import Api, ApiMaker

MIB = 1024 * 1024
HELD_AT_MOST_S = 1.0
"""Processor time of the whole process from one turn of the event loop to the next; a third of it where the machine is
not loaded.
"""


@pytest.fixture(scope="module")
def api(open_api: ApiMaker) -> Iterator[Api]:
    """One application for all tests here: none counts what is stored."""
    with open_api() as running:
        yield running


def pose(number: int) -> dict[str, Any]:
    return {
        "pose_id": f"P{number}",
        "position_mm": [123.456789012345, 1234.56789012345, -12.3456789012345],
        "roll_deg": 1.23456789012345,
        "pitch_deg": 1.23456789012345,
        "yaw_deg": 1.23456789012345,
        "joint_angles_deg": [12.3456789012345] * 12,
        "approach": "from above",
    }


def reading(number: int) -> dict[str, Any]:
    unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    covariance = [[0.00123456789 if row == column else 0.0 for column in range(6)] for row in range(6)]
    return {
        "pose_id": "P1",
        "cycle": number + 1,
        "position_mm": [1.5, 2.5, number / 7],
        "joint_angles_deg": [1.23456789] * 12,
        "rotation": unit,
        "covariance": covariance,
    }


def filled(item: str) -> str:
    """A list that fills a bulk body."""
    return "[" + (item * ((16 * MIB - 4) // len(item))).rstrip(",") + "]"


BODIES: dict[str, tuple[str, Callable[[], str], int]] = {
    "poses": ("poses", lambda: json.dumps([pose(i) for i in range(MAX_POSES)]), 200),
    "readings": (
        "measured-poses",
        lambda: json.dumps([reading(i) for i in range(MAX_MEASURED_POSES)]),
        200,
    ),
    "images": (
        "images/missing",
        lambda: json.dumps(
            {"images": [{"pose_id": "P1", "sha256": f"{i:064x}"} for i in range(MAX_IMAGE_NAMES)]}
        ),
        200,
    ),
    "numbers": ("poses", lambda: filled("1.5,"), 413),
    "lists": ("poses", lambda: filled("[],"), 413),
    "texts": ("poses", lambda: filled('"' + "\\u0041" * 100 + '",'), 422),
    "wrong poses": ("poses", lambda: json.dumps([{"pose_id": "/", "x": 1, "y": 2}] * MAX_POSES), 422),
    "wrong images": (
        "images/missing",
        lambda: json.dumps({"images": [{"pose_id": "/", "x": 1}] * MAX_IMAGE_NAMES}),
        422,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", BODIES)
def test_the_event_loop_goes_on_while_a_large_body_is_read(api: Any, kind: str) -> None:
    path, make, expected = BODIES[kind]
    body = make().encode()
    assert INLINE_LIMIT < len(body) <= 16 * MIB
    address = f"/v1/sessions/{api.make_session()}/{path}"
    headers = {"Content-Type": "application/json", **api.key("upload")}

    async def send(client: httpx2.AsyncClient) -> httpx2.Response:
        return await client.post(address, content=body, headers=headers, timeout=None)

    response, held_s = asyncio.run(watched(api.client.app, send))
    assert response.status_code == expected, response.text[:500]
    assert held_s < HELD_AT_MOST_S
    assert gc.isenabled()
    if expected == 422:
        assert 1 <= len(response.json()["errors"]) <= 100


async def watched(
    app: Any, send: Callable[[httpx2.AsyncClient], Awaitable[httpx2.Response]]
) -> tuple[httpx2.Response, float]:
    """Return an answer, and the most processor time that passed without a turn of the event loop."""
    async with httpx2.AsyncClient(
        transport=httpx2.ASGITransport(app=app), base_url="http://testserver"
    ) as client:
        await client.get("/livez")
        sending = asyncio.ensure_future(send(client))
        longest, last = 0.0, time.process_time()
        while not sending.done():
            await asyncio.sleep(0.002)
            now = time.process_time()
            longest, last = max(longest, now - last), now
        return sending.result(), longest


def test_few_large_bodies_are_received_at_a_time(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(json_body, "WAITING", 4)
    address = f"/v1/sessions/{api.make_session()}/poses"
    one, other = api.key("upload"), api.key("upload")
    content = json.dumps([pose(number) for number in range(400)]).encode()

    async def run() -> None:
        begun, gate = [], asyncio.Event()

        async def slow(key: dict[str, str]) -> AsyncIterator[bytes]:
            begun.append(key)
            yield content[:1000]
            await gate.wait()
            yield content[1000:]

        transport = httpx2.ASGITransport(app=api.client.app)
        async with httpx2.AsyncClient(transport=transport, base_url="http://testserver") as client:

            def send(key: dict[str, str], *, stated: bool) -> asyncio.Task[httpx2.Response]:
                headers = {"Content-Type": "application/json", **key}
                if stated:
                    headers["Content-Length"] = str(len(content))
                return asyncio.create_task(
                    client.post(address, content=slow(key), headers=headers, timeout=None)
                )

            async def settled(count: int) -> None:
                async with asyncio.timeout(60.0):
                    while len(begun) < count:
                        await asyncio.sleep(0.01)
                await asyncio.sleep(0.3)
                assert len(begun) == count

            sent = [send(one, stated=number % 2 == 0) for number in range(4)]
            await settled(2)  # a key's share
            refused = await client.post(address, json=[pose(number) for number in range(400)], headers=one)
            assert (refused.status_code, refused.json()["code"]) == (503, "busy")
            assert refused.headers["retry-after"] == "5"
            sent += [send(other, stated=True) for _ in range(3)]
            await settled(4)
            small = await client.post(address, json=[pose(1)], headers=one)
            assert small.status_code == 200
            gate.set()
            assert [response.status_code for response in await asyncio.gather(*sent)] == [200] * 7

    asyncio.run(run())


@pytest.mark.slow
def test_a_large_body_that_does_not_arrive_gives_its_place_to_others(
    serve_api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(json_body, "_ARRIVES_WITHIN_S", 1.0)
    with serve_api() as api, ExitStack() as stack:
        url = api.client.base_url
        address = f"/v1/sessions/{api.make_session()}/poses"
        head = (
            f"POST {address} HTTP/1.1\r\nHost: {url.host}\r\nContent-Type: application/json\r\n"
            f"Authorization: {api.client.headers['Authorization']}\r\nContent-Length: {MIB}\r\n\r\n["
        )
        for _ in range(json_body.IN_MEMORY):
            slow = stack.enter_context(socket.create_connection((url.host, url.port)))
            slow.sendall(head.encode())
        answer = api.client.post(address, json=[pose(number) for number in range(400)])
        assert answer.status_code == 200
        slow.settimeout(60)
        received = b""
        while b"incomplete_body" not in received and (
            more := slow.recv(65536)
        ):  # head and body may come one by one
            received += more
        assert b"incomplete_body" in received


def test_errors_of_a_large_list_name_their_items(api: Any) -> None:
    items = [pose(number) for number in range(1000)]
    items[3]["approach"] = 7
    items[777]["pose_id"] = "no/pose"
    response = api.client.post(f"/v1/sessions/{api.make_session()}/poses", json=items)
    assert len(json.dumps(items)) > INLINE_LIMIT
    assert (response.status_code, response.json()["code"]) == (422, "invalid_request")
    assert [error["field"] for error in response.json()["errors"]] == ["3.approach", "777.pose_id"]


def test_a_large_list_is_answered_as_a_small_one(api: Any) -> None:
    items = [pose(number) for number in range(1000)]
    session_id = api.make_session()
    large = api.client.post(f"/v1/sessions/{session_id}/poses", json=items)
    small = api.client.post(f"/v1/sessions/{session_id}/poses", json=items[:2])
    assert (large.status_code, small.status_code) == (200, 200)
    assert large.json()["items"] == items
    assert small.json()["items"] == items[:2]
    assert large.headers["content-type"] == small.headers["content-type"] == "application/json"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ('{"pose_id": "P1", "roll_deg": NaN}', "invalid_json"),
        ('{"pose_id": "P1", "pose_id": "P2"}', "invalid_json"),
        ('{"pose_id": "P1", "approach": "\\ud800"}', "invalid_json"),
        ('{"pose_id": "P1", "roll_deg": 1e999}', "invalid_request"),
        ('{"pose_id": "P1", "roll_deg": "1"}', "invalid_request"),
        ("{" + ",".join(f'"x{i}": 1' for i in range(1001)) + "}", "invalid_json"),
        ("[" * 10_000 + "]" * 10_000, "invalid_json"),
    ],
)
def test_a_large_body_is_read_as_strictly_as_a_small_one(api: Any, text: str, code: str) -> None:
    address = f"/v1/sessions/{api.make_session()}/poses"
    for body in (f"[{text}]", f"[{text},{json.dumps(pose(1))}{' ' * INLINE_LIMIT}]"):
        response = api.client.post(address, content=body, headers={"Content-Type": "application/json"})
        assert (response.status_code, response.json()["code"]) == (422, code)


@pytest.mark.parametrize(
    ("path", "most", "make"),
    [
        ("poses", MAX_POSES, lambda n: [{"pose_id": f"P{i}"} for i in range(n)]),
        (
            "measured-poses",
            MAX_MEASURED_POSES,
            lambda n: [{"pose_id": "P1", "cycle": i + 1, "position_mm": [1, 2, 3]} for i in range(n)],
        ),
        (
            "images/missing",
            MAX_IMAGE_NAMES,
            lambda n: {"images": [{"pose_id": "P1", "sha256": "0" * 64}] * n},
        ),
    ],
)
def test_a_list_has_a_largest_length_which_the_schema_states(
    api: Any, path: str, most: int, make: Callable[[int], Any]
) -> None:
    response = api.client.post(f"/v1/sessions/{api.make_session()}/{path}", json=make(most + 1))
    assert (response.status_code, response.json()["code"]) == (422, "invalid_request")
    assert response.json()["errors"][0]["message"] == f"must have at most {most} items"
    assert f'"maxItems": {most}' in json.dumps(api.client.get("/openapi.json").json())


def test_a_session_holds_so_many_measured_poses_and_no_more(api: Any) -> None:
    address = f"/v1/sessions/{api.make_session()}/measured-poses"

    def send(first: int, number: int) -> Any:
        return api.client.post(
            address,
            json=[
                {"pose_id": "P1", "cycle": cycle + 1, "position_mm": [1.0, 2.0, 3.0]}
                for cycle in range(first, first + number)
            ],
        )

    for first in range(0, MAX_IN_SESSION, MAX_MEASURED_POSES):
        assert send(first, min(MAX_MEASURED_POSES, MAX_IN_SESSION - first)).status_code == 200
    one_more = send(MAX_IN_SESSION, 1)
    assert (one_more.status_code, one_more.json()["code"]) == (409, "too_many_measured_poses")
    assert one_more.json()["advice"]
    assert send(MAX_IN_SESSION - 1, 1).status_code == 200, "what is stored may be sent again"
