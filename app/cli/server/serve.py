"""`gridpose serve`: the HTTP service and its workers in the foreground, until SIGTERM or Ctrl-C."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer
import uvicorn
from fastapi import FastAPI

from app.build import core_version
from app.cli.context import data_failures, load_settings, open_context, warn_of_unknown_settings
from app.cli.options.data_folder import DataDir
from app.cli.server.connections import Connection, allow_many_connections
from app.cli.server.first_key import announce_admin_key, ensure_admin_key
from app.cli.server.supervision import Supervisor
from app.client.commands import fail
from app.logs import Logger, configure_logging
from app.main import create_app
from app.records.file_lock import AlreadyLocked, FileLock
from app.settings import Settings, is_loopback

_MAX_REQUEST_SHUTDOWN_S = 8
"""Time for open requests after SIGTERM; with the workers' own time the shutdown stays below 25 s."""
_MAX_GIVE_UP_SHUTDOWN_S = 15.0
"""Time for the shutdown after the runner gave up; with the runner's `MAX_UNABLE_S` it stays below 60 s."""

log = Logger(__name__)


def serve(
    host: Annotated[
        str | None, typer.Option(help="Address to listen on.  [default: GRIDPOSE_HOST, 127.0.0.1]")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(help="0 takes any free port.  [default: GRIDPOSE_PORT, 8000]", min=0, max=65535),
    ] = None,
    data_dir: DataDir = None,
    adopt: Annotated[
        bool,
        typer.Option(
            "--adopt",
            help="Bind this data folder, and the pepper it has, to the database, where the other was lost. "
            "A new pepper revokes all keys.",
        ),
    ] = False,
) -> int:
    """Run the service: HTTP, and GRIDPOSE_WORKERS worker processes (default: one a core)."""
    settings = load_settings(host=host, port=port, data_dir=data_dir)
    configure_logging(settings.log_level)
    warn_of_unknown_settings()
    allow_many_connections()
    listener = listen(settings)
    require_unlocked(settings, "head.lock", f"Another `gridpose serve` uses {settings.data_dir}.")
    if settings.worker_count:
        require_no_runner(settings)
    installation = open_context(settings, init=True, adopt=adopt, migrate=True)
    try:
        with data_failures(settings):
            installation.blobs.check_access()
            key_file = ensure_admin_key(installation)
    finally:
        installation.close()

    app = create_app(settings)
    server = _Server(
        uvicorn.Config(
            app,
            http=Connection,
            # `X-Forwarded-For` is ours to read (GRIDPOSE_TRUSTED_PROXIES): uvicorn would believe every local program.
            proxy_headers=False,
            log_config=None,
            access_log=False,
            server_header=False,
            ws="none",
            lifespan="on",
            timeout_graceful_shutdown=_MAX_REQUEST_SHUTDOWN_S,
        ),
        app,
    )
    if not is_loopback(settings.host):
        log.warning("plain_http", host=settings.host)
    with stdout_may_fail():
        _announce(settings, listener, key_file)
    # uvicorn raises the signal that ended it once more when all is done, for the handlers that stood before its
    # own: with these, an orderly end is exit code 0.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: None)
    server.run(sockets=[listener])
    return 0 if server.started and not server.gave_up else 1


def require_no_runner(settings: Settings) -> None:
    """End the command where another process already runs jobs of this data folder."""
    require_unlocked(settings, "runner.lock", f"Another process computes the images of {settings.data_dir}.")


def require_unlocked(settings: Settings, name: str, message: str) -> None:
    """End the command where another process holds a lock that this one needs; create no file."""
    lock = FileLock(settings.data_dir / name)
    try:
        with data_failures(settings):
            if not lock.path.exists():
                return
            lock.acquire()
    except AlreadyLocked:
        fail(message, "Stop that process, or choose another --data-dir.")
    lock.release()


class _Server(uvicorn.Server):
    """A server that shuts down its workers and event streams before it waits for open connections.

    Its event loop reports to the process's supervisor, and ends the process where the runner gave up.
    """

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
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
        """Report the shutdown to the supervisor, then shut down."""
        self._supervisor.stopping()
        await super().shutdown(sockets)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        begin_shutdown = getattr(self._app.state, "begin_shutdown", None)
        if begin_shutdown is not None:
            begin_shutdown()
        super().handle_exit(sig, frame)


def end_after_giving_up() -> None:
    """Log the reason, and exit by force where the shutdown takes too long: acknowledged uploads are on disk."""
    log.critical(
        "nothing_can_be_computed",
        advice="The process exits to be restarted. See the messages before this one; check memory and limits.",
    )
    last_resort = threading.Timer(_MAX_GIVE_UP_SHUTDOWN_S, os._exit, [1])
    last_resort.daemon = True
    last_resort.start()


def listen(settings: Settings) -> socket.socket:
    """Return a listening socket on the settings' address; a failure ends the command."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    # asyncio turns Nagle's algorithm off only where the protocol is given explicitly: with 0, which means the same,
    # every response on a kept connection waits 40 ms for the client's delayed acknowledgement.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        if os.name == "posix":  # elsewhere this option would let two programs share the port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((settings.host, settings.port))
        listener.listen(2048)
        return listener
    except OSError as error:
        listener.close()
        fail(
            f"Cannot listen on {settings.host}, port {settings.port}: {error.strerror or error}.",
            "Another program may use the port: choose another with --port, or --port 0 for any free one.",
        )


@contextmanager
def stdout_may_fail() -> Iterator[None]:
    """Continue where stdout is closed or on a full disk: its messages are not needed to serve."""
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        # Its buffer would fail again when the interpreter exits, which then reports exit code 120.
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - for as long as the process runs
        log.warning("stdout_lost", reason=error.strerror or str(error))


def _announce(settings: Settings, listener: socket.socket, key_file: Path | None) -> None:
    """Print the address of the service; the key comes first, for programs that read up to the address."""
    port = listener.getsockname()[1]
    host = socket.gethostname() if settings.host in ("0.0.0.0", "::") else settings.host  # noqa: S104
    url = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
    print(f"Gridpose {core_version()}")
    print(f"  data       {settings.data_dir}")
    if key_file is not None:
        announce_admin_key(key_file)
    if settings.auth == "off":
        print("  keys       none are asked for (GRIDPOSE_AUTH=off)")
    if not is_loopback(settings.host):
        print(
            "  transport  plain HTTP: others on the network can read keys; put a reverse proxy with TLS before it"
        )
    print(f"  workers    {settings.worker_count}")
    print(f"  dashboard  {url}/ui/")
    print(f"  API        {url}/docs")
    print(f"  service    {url}", flush=True)
