"""Answers with gzip: JSON, SVG and CSV for who accepts it, nothing else, with the tags that HTTP asks for."""

from __future__ import annotations

import asyncio
import gzip
from typing import Any

import pytest

from app.api.middleware.compression import Compression, accepts_gzip

LARGE = b"x" * 200_000


def answer(accept_encoding: str, messages: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Send the messages of an application through the middleware; return what comes out."""
    sent: list[dict[str, Any]] = []

    async def application(scope: Any, receive: Any, send: Any) -> None:
        for message in messages:
            await send(message)

    async def keep(message: Any) -> None:
        sent.append(message)

    headers = [(b"accept-encoding", accept_encoding.encode())]
    scope = {"type": "http", "headers": headers}
    asyncio.run(Compression(application)(scope, None, keep))  # type: ignore[arg-type]
    return sent


def start(media_type: str, **headers: str) -> dict[str, Any]:
    named = {"content-type": media_type, **headers}
    pairs = [(name.encode(), value.encode()) for name, value in named.items()]
    return {"type": "http.response.start", "status": 200, "headers": pairs}


def body(data: bytes, more: bool = False) -> dict[str, Any]:
    return {"type": "http.response.body", "body": data, "more_body": more}


@pytest.mark.parametrize("media_type", ["application/json", "image/svg+xml", "text/csv; charset=utf-8"])
def test_a_whole_answer_is_compressed(media_type: str) -> None:
    tagged = start(media_type, etag='"a"', **{"content-length": str(len(LARGE))})
    first, second = answer("gzip, br", [tagged, body(LARGE)])
    headers = dict(first["headers"])
    assert headers[b"content-encoding"] == b"gzip"
    assert int(headers[b"content-length"]) == len(second["body"]) < len(LARGE)
    assert headers[b"etag"] == b'W/"a"'
    assert headers[b"vary"] == b"Accept-Encoding"
    assert gzip.decompress(second["body"]) == LARGE


@pytest.mark.parametrize(
    ("accept", "messages"),
    [
        ("identity", [start("application/json", etag='"a"'), body(LARGE)]),
        ("gzip;q=0", [start("application/json"), body(LARGE)]),
        ("gzip", [start("application/json"), body(b"{}")]),
        ("gzip", [start("image/png"), body(LARGE)]),
        ("gzip", [start("text/html"), body(LARGE)]),
        ("gzip", [start("application/json"), body(LARGE, more=True), body(b"")]),
        ("gzip", [start("text/event-stream"), body(LARGE, more=True), body(b"")]),
    ],
)
def test_what_is_small_a_stream_or_not_asked_for_passes(accept: str, messages: list[dict[str, Any]]) -> None:
    sent = answer(accept, messages)
    assert [m.get("body") for m in sent] == [m.get("body") for m in messages]
    headers = dict(sent[0]["headers"])
    assert b"content-encoding" not in headers
    assert headers.get(b"etag", b'"a"') == b'"a"'


def test_the_start_of_a_stream_is_not_held() -> None:
    (only,) = answer("gzip", [start("text/event-stream")])
    assert only["type"] == "http.response.start"


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("", False),
        ("gzip", True),
        ("br, GZIP;q=0.5", True),
        ("gzip;q=0", False),
        ("*", True),
        ("gzip;q=x", False),
    ],
)
def test_what_a_client_accepts(header: str, expected: bool) -> None:
    assert accepts_gzip(header) is expected


def test_the_service_compresses_lists_and_answers_tags_of_either_form(api: Any) -> None:
    for _ in range(12):
        api.make_target()
    plain = api.client.get("/v1/targets", headers={"Accept-Encoding": "identity"})
    coded = api.client.get("/v1/targets", headers={"Accept-Encoding": "gzip"})
    assert (plain.headers.get("content-encoding"), coded.headers["content-encoding"]) == (None, "gzip")
    assert plain.json() == coded.json()
    assert plain.headers["vary"] == coded.headers["vary"] == "Accept, Accept-Encoding"
    head = api.client.head("/v1/targets", headers={"Accept-Encoding": "gzip"})
    assert (head.content, head.headers["content-encoding"]) == (b"", "gzip")
