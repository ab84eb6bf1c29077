"""Connection timeouts: slow request heads, dead peers, and requests whose body is no longer wanted."""

from __future__ import annotations

import asyncio
import socket
import sys
from typing import Any, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from app.api.problems import problem_response

MAX_HEAD_S = 10.0
"""From the first byte of a request, or the start of the connection, to the end of the request's head."""
_MAX_FILES = 65536
_TOGETHER_BYTES = 16 * 1024
_PROBE_AFTER_S, _PROBE_EVERY_S, _PROBES = 60, 15, 4


class _OneWrite:
    """A transport that passes on together what is written in one turn of the event loop: an answer's head and body."""

    def __init__(self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop) -> None:
        self._transport, self._loop = transport, loop
        self._pending = b""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Send the bytes at the end of this turn, or at once where they are many."""
        if len(self._pending) + len(data) > _TOGETHER_BYTES:
            self._flush()
            self._transport.write(data)
            return
        if not self._pending:
            self._loop.call_soon(self._flush)
        self._pending += data

    def close(self) -> None:
        """Send what is left, and close."""
        self._flush()
        self._transport.close()

    def _flush(self) -> None:
        data, self._pending = self._pending, b""
        if data:
            self._transport.write(data)


class Connection(H11Protocol):
    """uvicorn's connection, which has no timeout for a request's head."""

    _head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the head's timeout, and let the system probe whether the client's machine still exists."""
        super().connection_made(transport)
        self.transport = cast("asyncio.Transport", _OneWrite(transport, self.loop))
        peer: socket.socket | None = transport.get_extra_info("socket")
        if peer is not None:
            _probe(peer)
        self._watch_head()

    def data_received(self, data: bytes) -> None:
        """Handle the bytes; start or stop the head's timeout."""
        super().data_received(data)
        self._watch_head()

    def on_response_complete(self) -> None:
        """Continue with the next request; close the connection where the rest of this one was not received."""
        # Determined first: the call below may begin the next request.
        unfinished = self.conn.their_state is h11.SEND_BODY
        super().on_response_complete()
        if unfinished:
            self.transport.close()

    def send_400_response(self, msg: str) -> None:
        """Answer invalid HTTP with a problem document, as every other refusal."""
        problem = problem_response(
            400,
            "invalid_request",
            "The request cannot be read.",
            "Send HTTP/1.1 with a valid head and body length.",
        )
        if self.conn.our_state not in (h11.IDLE, h11.SEND_RESPONSE):  # a response was already begun
            self.transport.close()
            return
        headers = [*problem.raw_headers, (b"connection", b"close")]
        for event in (
            h11.Response(status_code=400, headers=headers, reason=b"Bad Request"),
            h11.Data(data=bytes(problem.body)),
            h11.EndOfMessage(),
        ):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timeout."""
        self._stop_watching()
        super().connection_lost(exc)

    def _watch_head(self) -> None:
        if self.conn.their_state is not h11.IDLE:
            self._stop_watching()
        elif self._head_timer is None:
            # Further bytes do not restart it: a client that sends single bytes would hold the connection forever.
            self._head_timer = self.loop.call_later(MAX_HEAD_S, self.transport.close)

    def _stop_watching(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None


def allow_many_connections() -> None:
    """Raise the limit of open files as far as allowed; the usual default admits about a thousand connections."""
    if sys.platform == "win32":
        return
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _MAX_FILES if hard == resource.RLIM_INFINITY else min(hard, _MAX_FILES)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def _probe(peer: socket.socket) -> None:
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (
        ("TCP_KEEPIDLE", _PROBE_AFTER_S),
        ("TCP_KEEPINTVL", _PROBE_EVERY_S),
        ("TCP_KEEPCNT", _PROBES),
    ):
        if hasattr(socket, name):  # not everywhere
            peer.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
