"""`gridpose serve`: the HTTP service and its workers in the foreground, until SIGTERM or Ctrl-C.

What may refuse the start comes first, and loads nothing of what serves.
"""

from __future__ import annotations

import errno
import os
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from app.build import core_version
from app.cli.context import data_failures, load_settings, open_context, warn_of_unknown_settings
from app.cli.options.data_folder import DataDir
from app.cli.server.exclusion import require_no_runner, require_unlocked
from app.cli.server.first_key import announce_admin_key, ensure_admin_key
from app.client.commands import fail, uncollected
from app.logs import Logger, configure_logging
from app.settings import Settings, is_loopback

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

    # The framework and every route, three quarters of a start's processor time: not for one that is refused.
    with uncollected():
        from app.cli.server.http_server import HttpServer
    server = HttpServer(settings)
    if not is_loopback(settings.host):
        log.warning("plain_http", host=settings.host)
    # From before the address is printed, which is when others may ask for the end: the server heeds what was noted
    # before it runs. uvicorn raises the signal that ended it once more when all is done, for the handlers that stood
    # before its own: with these, an orderly end is exit code 0.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, server.handle_exit)
    with stdout_may_fail():
        _announce(settings, listener, key_file)
    server.run(sockets=[listener])
    return 0 if server.started and not server.gave_up else 1


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
            _listening_advice(error),
        )


def _listening_advice(error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return "Another program uses the port: choose another with --port, or --port 0 for any free one."
    if error.errno in (errno.EACCES, errno.EPERM):
        return "This user may not use the port: choose one above 1023 with --port."
    return (
        "Name an address of this machine with --host or GRIDPOSE_HOST, without brackets: 127.0.0.1 or ::1 for this "
        "machine alone."
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
