"""The server of `gridpose serve`: the application on its connections, with the state of its process."""

from __future__ import annotations

import asyncio
import os
import socket
from types import FrameType

import uvicorn

from app.cli.server.connections import Connection, allow_many_connections
from app.cli.server.supervision import Supervisor, end_after_giving_up
from app.main import create_app
from app.settings import Settings

_MAX_REQUEST_SHUTDOWN_S = 8
"""Time for open requests after SIGTERM; with the workers' own time the shutdown stays below 25 s."""
_MAX_PARTING_S = 1
"""Time for requests whose connection was closed then; what does not end by itself is cancelled."""


class HttpServer(uvicorn.Server):
    """A server that shuts down its workers and event streams before it waits for open connections.

    Its event loop reports to the process's supervisor, and ends the process where the runner gave up.
    """

    def __init__(self, settings: Settings) -> None:
        allow_many_connections()
        app = create_app(settings)
        super().__init__(
            uvicorn.Config(
                app,
                http=Connection,
                # `X-Forwarded-For` is ours to read (GRIDPOSE_TRUSTED_PROXIES): uvicorn would believe every local
                # program.
                proxy_headers=False,
                log_config=None,
                access_log=False,
                server_header=False,
                ws="none",
                lifespan="on",
                timeout_graceful_shutdown=_MAX_REQUEST_SHUTDOWN_S + _MAX_PARTING_S,
            )
        )
        self.gave_up = False
        self._app = app
        self._supervisor = Supervisor.from_environment(os.environ)

    async def on_tick(self, counter: int) -> bool:
        """Report to the supervisor ten times a second; return whether the server shall exit."""
        runner = self._app.state.service.runner
        if runner is not None and runner.given_up and not self.gave_up:
            self.gave_up = True
            end_after_giving_up()
            self._app.state.begin_shutdown()
        if not self.gave_up:
            self._supervisor.beat(ready=runner is None or runner.state.ready > 0)
        return await super().on_tick(counter) or self.gave_up

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Report the shutdown to the supervisor, let the application begin it, then shut down."""
        self._supervisor.stopping()
        self._app.state.begin_shutdown()
        parting = asyncio.get_running_loop().call_later(_MAX_REQUEST_SHUTDOWN_S, self._leave_clients)
        await super().shutdown(sockets)
        parting.cancel()

    def _leave_clients(self) -> None:
        """Close the connections that are still open: their requests end as when a client goes, which is no failure."""
        for connection in list(self.server_state.connections):
            connection.transport.abort()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Note a signal; the event loop shuts down at its next tick. A second Ctrl-C waits for nothing any more.

        No more than that: a signal handler interrupts code that may hold the very locks that the shutdown takes.
        """
        super().handle_exit(sig, frame)
