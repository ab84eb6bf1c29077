"""Connections that send nothing, or never the end of a request, are answered and ended; others are kept."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
import uvicorn
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.server import ServerState

from app.api.metrics import Metrics
from app.api.middleware import requests
from app.api.middleware.requests import RequestMiddleware
from app.api.problems import problem_response
from app.cli.server import connections
from app.cli.server.connections import Connection

Talk = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[bytes]]


async def hello(scope: Scope, receive: Receive, send: Send) -> None:
    await PlainTextResponse("hello")(scope, receive, send)


async def refuse(scope: Scope, receive: Receive, send: Send) -> None:
    problem = problem_response(413, "upload_too_large", "An image file may have at most 10 bytes.")
    await problem(scope, receive, send)


TERABYTE = 10**12


def talk(conversation: Talk, app: ASGIApp = hello) -> bytes:
    """Return the answer to a client that behaves like `conversation`."""

    async def run() -> bytes:
        config = uvicorn.Config(app, log_config=None)
        config.load()
        server = await asyncio.get_running_loop().create_server(
            lambda: Connection(config, ServerState(), {}), "127.0.0.1", 0
        )
        async with server:
            reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
            try:
                async with asyncio.timeout(120):
                    return await conversation(reader, writer)
            finally:
                writer.transport.abort()

    return asyncio.run(run())


@pytest.mark.parametrize("beginning", [b"", b"GET / HTTP/1.1\r\nHost: x\r\nX-Slow: "])
def test_a_head_that_does_not_come_ends_the_connection(
    monkeypatch: pytest.MonkeyPatch, beginning: bytes
) -> None:
    monkeypatch.setattr(connections, "MAX_HEAD_S", 0.05)

    async def conversation(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
        writer.write(beginning)
        return await reader.read()

    assert talk(conversation) == b""


def test_a_request_that_comes_in_pieces_is_answered() -> None:
    async def conversation(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
        for piece in (b"GET / HT", b"TP/1.1\r\nHost: x\r\n", b"Connection: close\r\n\r\n"):
            writer.write(piece)
            await writer.drain()
        return await reader.read()

    assert talk(conversation).endswith(b"\r\n\r\nhello")


async def answer_of(reader: asyncio.StreamReader) -> tuple[bytes, bytes]:
    """Read one answer by its stated length; return its head, in lower case, and its body."""
    head = (await reader.readuntil(b"\r\n\r\n")).lower()
    length = int(head.split(b"content-length:")[1].split(b"\r\n")[0])
    return head, await reader.readexactly(length)


def request(*lines: str, body: bytes = b"") -> bytes:
    return "\r\n".join(["PUT / HTTP/1.1", "Host: x", *lines, "", ""]).encode() + body


@pytest.mark.parametrize(
    ("lines", "body", "ends"),
    [
        ((f"Content-Length: {TERABYTE}",), b"", True),
        ((f"Content-Length: {TERABYTE}", "Expect: 100-continue"), b"", True),
        ((f"Content-Length: {10**20 - 1}",), b"the beginning", True),
        (("Content-Length: 20000000",), b"", False),
        (("Content-Length: 20000000", "Expect: 100-continue"), b"", True),
        (("Transfer-Encoding: chunked",), b"4\r\npart\r\n", False),
    ],
)
def test_a_refusal_does_not_wait_for_a_body_that_never_comes(
    monkeypatch: pytest.MonkeyPatch, lines: tuple[str, ...], body: bytes, ends: bool
) -> None:
    monkeypatch.setattr(requests, "_DRAIN_S", 3600.0)

    async def conversation(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
        writer.write(request(*lines, body=body))
        head, problem = await answer_of(reader)
        assert head.startswith(b"http/1.1 413")
        assert (b"connection: close" in head) is ends
        return problem

    assert b"upload_too_large" in talk(conversation, RequestMiddleware(refuse, Metrics()))


@pytest.mark.parametrize("refused", [False, True])
def test_a_connection_is_kept_where_the_body_comes_after_the_answer(refused: bool) -> None:
    body = bytes(3_000_000)

    async def conversation(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
        for _ in range(2):
            writer.write(request(f"Content-Length: {len(body)}"))
            _, answer = await answer_of(reader)
            writer.write(body)
            await writer.drain()
        return answer

    expected = b"upload_too_large" if refused else b"hello"
    assert expected in talk(conversation, RequestMiddleware(refuse if refused else hello, Metrics()))


def test_a_client_that_sends_all_before_it_reads_comes_to_read_the_answer() -> None:
    async def conversation(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
        writer.write(request(f"Content-Length: {TERABYTE}"))
        for _ in range(64):
            writer.write(bytes(1 << 20))
            await writer.drain()
        return (await answer_of(reader))[1]

    assert b"upload_too_large" in talk(conversation, RequestMiddleware(refuse, Metrics()))


@pytest.mark.parametrize("length", [100, TERABYTE])
def test_a_body_that_is_not_wanted_and_does_not_come_ends_the_connection(
    monkeypatch: pytest.MonkeyPatch, length: int
) -> None:
    monkeypatch.setattr(requests, "_DRAIN_S", 0.05)

    async def conversation(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
        writer.write(request(f"Content-Length: {length}", body=b"a little"))
        await answer_of(reader)
        return await reader.read()

    for app in (RequestMiddleware(refuse, Metrics()), hello):
        assert talk(conversation, app) == b""


@pytest.mark.parametrize(
    "lines",
    [
        (f"Content-Length: {10**20}",),
        ("Content-Length: " + "9" * 5000,),
        ("Content-Length: abc",),
        ("Content-Length: -1",),
        ("Content-Length: 1", "Content-Length: 2"),
        ("Transfer-Encoding: surprise",),
    ],
)
def test_what_is_no_length_is_refused_by_a_problem_document(lines: tuple[str, ...]) -> None:
    async def conversation(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bytes:
        writer.write(request(*lines))
        head, problem = await answer_of(reader)
        assert b"content-type: application/problem+json" in head
        assert await reader.read() == b""
        return head + problem

    answer = talk(conversation)
    assert answer.startswith((b"http/1.1 400", b"http/1.1 501"))
    assert b'"code":"invalid_request"' in answer
