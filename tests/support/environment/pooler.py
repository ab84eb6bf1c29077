"""A pooler in transaction mode, like pgbouncer: the server's connections change clients between transactions.

It passes PostgreSQL's messages on as they are and knows of them the type, the length, and of `ReadyForQuery` the state.
"""

from __future__ import annotations

import socket
import struct
import threading
from contextlib import suppress
from types import TracebackType
from typing import Self

import sqlalchemy as sa

from tests.support.environment.connections import accepted

_SSL_REQUEST, _GSS_REQUEST = 80877103, 80877104
_PARAMETERS = {"server_version": "15.0", "client_encoding": "UTF8", "standard_conforming_strings": "on"}


class TransactionPooler:
    """Listens on a port of this machine and passes transactions on to the server of `url`, which must trust it."""

    def __init__(self, url: str) -> None:
        self._server = sa.make_url(url)
        self._free: list[socket.socket] = []
        self._taken = threading.Lock()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._clients: list[socket.socket] = []
        port = self._listener.getsockname()[1]
        self.url = self._server.set(host="127.0.0.1", port=port).render_as_string(hide_password=False)

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for each in (self._listener, *self._clients, *self._free):
            each.close()

    def _accept(self) -> None:
        for client in accepted(self._listener):
            self._clients.append(client)
            threading.Thread(target=self._serve, args=(client, len(self._clients)), daemon=True).start()

    def _serve(self, client: socket.socket, number: int) -> None:
        with suppress(OSError, ConnectionError), client:
            while True:
                (length,) = struct.unpack(">I", _exactly(client, 4))
                (protocol,) = struct.unpack(">I", _exactly(client, length - 4)[:4])
                if protocol not in (_SSL_REQUEST, _GSS_REQUEST):
                    break
                client.sendall(b"N")
            client.sendall(_message(b"R", struct.pack(">I", 0)))
            for name, value in _PARAMETERS.items():
                client.sendall(_message(b"S", f"{name}\0{value}\0".encode()))
            # A pooler's clients have numbers of its own, which no process of the server has.
            client.sendall(_message(b"K", struct.pack(">II", 2**30 + number, 0)) + _message(b"Z", b"I"))
            self._pass_on(client)

    def _pass_on(self, client: socket.socket) -> None:
        server: socket.socket | None = None
        while True:
            kind, message = _read(client)
            if kind == b"X":
                return
            if server is None:
                with self._taken:
                    server = self._free.pop() if self._free else None
                server = server or self._connect()
            server.sendall(message)
            if kind not in (b"Q", b"S"):
                continue
            kind = b""
            while kind != b"Z":
                kind, answer = _read(server)
                if kind == b"Z" and answer[-1:] == b"I":  # no transaction is open
                    with self._taken:
                        self._free.append(server)
                client.sendall(answer)
            if answer[-1:] == b"I":
                server = None

    def _connect(self) -> socket.socket:
        server = socket.create_connection((self._server.host or "127.0.0.1", self._server.port or 5432))
        stated = {"user": self._server.username or "postgres", "database": self._server.database or ""}
        start = b"".join(f"{name}\0{value}\0".encode() for name, value in stated.items()) + b"\0"
        server.sendall(struct.pack(">II", len(start) + 8, 196608) + start)
        while True:
            kind, message = _read(server)
            assert kind != b"E", message
            assert kind != b"R" or message[5:9] == b"\0\0\0\0", "the server must trust this machine"
            if kind == b"Z":
                return server


def _read(connection: socket.socket) -> tuple[bytes, bytes]:
    """Return the next message's type, and the message."""
    head = _exactly(connection, 5)
    (length,) = struct.unpack(">I", head[1:])
    return head[:1], head + _exactly(connection, length - 4)


def _message(kind: bytes, body: bytes) -> bytes:
    return kind + struct.pack(">I", len(body) + 4) + body


def _exactly(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = connection.recv(size - len(data))
        if not part:
            raise ConnectionError
        data += part
    return data
