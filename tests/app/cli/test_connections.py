"""Connections that send nothing, or never the end of a request's head, are ended."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
import uvicorn
from starlette.responses import PlainTextResponse
from uvicorn.server import ServerState

from app.cli import connections
from app.cli.connections import Connection

Talk = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[bytes]]


def talk(conversation: Talk) -> bytes:
    """Return what a client is told that behaves like `conversation`."""

    async def run() -> bytes:
        config = uvicorn.Config(PlainTextResponse("hello"), log_config=None)
        config.load()
        server = await asyncio.get_running_loop().create_server(
            lambda: Connection(config, ServerState(), {}), "127.0.0.1", 0
        )
        async with server:
            reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
            async with asyncio.timeout(30):
                answer = await conversation(reader, writer)
            writer.close()
            await writer.wait_closed()
            return answer

    return asyncio.run(run())


@pytest.mark.parametrize("beginning", [b"", b"GET / HTTP/1.1\r\nHost: x\r\nX-Slow: "])
def test_a_head_that_does_not_come_ends_the_connection(
    monkeypatch: pytest.MonkeyPatch, beginning: bytes
) -> None:
    monkeypatch.setattr(connections, "HEAD_WITHIN_S", 0.05)

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
