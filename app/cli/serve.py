"""`gridpose serve`: the HTTP service and its workers in the foreground, until SIGTERM or Ctrl-C."""

from __future__ import annotations

import os
import signal
import socket
from importlib.metadata import version
from pathlib import Path
from types import FrameType

import uvicorn

from app.cli.configuration import fail, load_settings, open_installation
from app.cli.connections import Connection, allow_many_connections
from app.logs import configure_logging
from app.main import create_app
from app.records.lock import AlreadyLocked, FileLock
from app.services.installation import Installation
from app.services.keys import create_key, list_keys
from app.settings import Settings

# Requests under way get this long on SIGTERM; then the workers get theirs. Together they stay below 25 s.
_LAST_REQUESTS_S = 8


def serve(host: str | None, port: int | None, data_dir: Path | None) -> int:
    """Serve until told to end; return the exit code."""
    settings = load_settings(host=host, port=port, data_dir=data_dir)
    configure_logging(settings.log_level)
    allow_many_connections()
    listener = listen(settings)
    installation = open_installation(settings)
    require_unlocked(settings, "head.lock", f"Another `gridpose serve` uses {settings.data_dir}.")
    if settings.worker_count:
        require_no_runner(settings)
    try:
        admin_key = _first_admin_key(installation)
    finally:
        installation.close()

    app = create_app(settings)
    server = _Server(
        uvicorn.Config(
            app,
            http=Connection,
            log_config=None,
            access_log=False,
            server_header=False,
            ws="none",
            lifespan="on",
            timeout_graceful_shutdown=_LAST_REQUESTS_S,
        )
    )
    _announce(settings, listener, admin_key)
    # uvicorn raises the signal that ended it once more when all is done, for the handlers that stood before its
    # own: with these, an orderly end is exit code 0.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: None)
    server.run(sockets=[listener])
    return 0 if server.started else 1


def require_no_runner(settings: Settings) -> None:
    """End the command where another process already runs jobs of this data folder."""
    require_unlocked(settings, "runner.lock", f"Another process computes the images of {settings.data_dir}.")


def require_unlocked(settings: Settings, name: str, message: str) -> None:
    """End the command with a sentence where another process holds a lock that this one will need."""
    lock = FileLock(settings.data_dir / name)
    try:
        lock.acquire()
    except AlreadyLocked:
        fail(message, "End that one, or give another --data-dir.")
    lock.release()


class _Server(uvicorn.Server):
    """A server that tells its workers and event streams to end before it waits for open connections."""

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        begin_shutdown = getattr(self.config.app.state, "begin_shutdown", None)  # type: ignore[union-attr]
        if begin_shutdown is not None:
            begin_shutdown()
        super().handle_exit(sig, frame)


def listen(settings: Settings) -> socket.socket:
    """Return a listening socket on the settings' address; ends the command where that cannot be had."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    # The protocol is named because asyncio turns Nagle's algorithm off only where it is: with 0, which means the
    # same, every answer on a kept connection waits 40 ms for the client's delayed acknowledgement.
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
            "Another program may have the port: give another with --port, or --port 0 for any free one.",
        )


def _first_admin_key(installation: Installation) -> str | None:
    """Make an admin key where there never was one; without it nobody could use the service."""
    if installation.settings.auth == "off":
        return None
    cursor: str | None = None
    while True:
        keys, cursor = list_keys(installation, cursor=cursor)
        if any(key.scope == "admin" for key in keys):
            return None
        if cursor is None:
            return create_key(installation, "first admin key", "admin").secret_key


def _announce(settings: Settings, listener: socket.socket, admin_key: str | None) -> None:
    """Print where the service is; the key before the address, for programs that read up to that line."""
    port = listener.getsockname()[1]
    host = socket.gethostname() if settings.host in ("0.0.0.0", "::") else settings.host  # noqa: S104
    url = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
    print(f"Gridpose {version('gridpose')}")
    print(f"  data       {settings.data_dir}")
    if admin_key is not None:
        print(f"  admin key  {admin_key}")
        print("             shown only this once; `gridpose keys` makes and revokes others")
    if settings.auth == "off":
        print("  keys       none are asked for (GRIDPOSE_AUTH=off)")
    print(f"  workers    {settings.worker_count}")
    print(f"  API        {url}/docs")
    print(f"  service    {url}", flush=True)
