"""The socket the service listens on."""

from __future__ import annotations

import asyncio
import socket

from app.cli.serve import listen
from app.settings import Settings


def test_answers_do_not_wait_for_delayed_acknowledgements() -> None:
    listener = listen(Settings(host="127.0.0.1", port=0))
    address = listener.getsockname()

    async def accepted_without_delay() -> bool:
        seen: asyncio.Queue[int] = asyncio.Queue()

        async def on_connect(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            accepted: socket.socket = writer.get_extra_info("socket")
            seen.put_nowait(accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        async with await asyncio.start_server(on_connect, sock=listener):
            _, writer = await asyncio.open_connection(*address)
            value = await seen.get()
            writer.close()
            await writer.wait_closed()
            return value != 0

    assert asyncio.run(accepted_without_delay())
