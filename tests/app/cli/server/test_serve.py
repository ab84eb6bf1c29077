"""The socket the service listens on, what it prints, and how it is stopped."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import typer

from app.cli.server import http_server
from app.cli.server.connections import Connection
from app.cli.server.http_server import HttpServer
from app.cli.server.serve import listen
from app.cli.server.worker import StopRequested
from app.settings import Settings
from tests.support.service.service import wait_until


@pytest.mark.parametrize(("host", "advised"), [("127.0.0.1", "--port 0"), ("[::1]", "without brackets")])
def test_who_cannot_listen_is_advised_of_what_helps(
    host: str, advised: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other, pytest.raises(typer.Exit):
        listen(Settings(host=host, port=other.getsockname()[1]))
    assert advised in " ".join(capsys.readouterr().err.split())


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


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a file on which nothing has room")
def test_a_full_disk_under_stdout_does_not_end_the_start() -> None:
    """And a start that is refused, or computes without HTTP, does not pay for what serves."""
    script = (
        "import sys\n"
        "import app.cli.server.worker\n"
        "from app.cli.server.serve import stdout_may_fail\n"
        "assert not {'core', 'fastapi', 'uvicorn'} & set(sys.modules)\n"
        "from app.logs import configure_logging\n"
        "configure_logging()\n"
        "with stdout_may_fail():\n"
        "    print('x' * 100_000)\n"
        "print('more', flush=True)\n"
        "print('served', file=sys.stderr)\n"
    )
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-c", script], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert ended.returncode == 0, ended.stderr
    assert "stdout_lost" in ended.stderr
    assert "served" in ended.stderr


@pytest.mark.slow
def test_a_signal_between_the_printed_address_and_the_server_s_loop_ends_the_service(tmp_path: Path) -> None:
    program = (
        "import os, signal, uvicorn\n"
        "run = uvicorn.Server.run\n"
        "def signalled(self, sockets):\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "    run(self, sockets)\n"
        "uvicorn.Server.run = signalled\n"
        "from app.cli.server.serve import serve\n"
        "raise SystemExit(serve(port=0))\n"
    )
    environment = {**os.environ, "GRIDPOSE_DATA_DIR": str(tmp_path / "data"), "GRIDPOSE_WORKERS": "0"}
    environment["GRIDPOSE_DISK_FLOOR_BYTES"] = "0"
    ended = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, timeout=240, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert b"  service " in ended.stdout


def test_a_worker_is_stopped_by_a_signal_that_takes_no_lock() -> None:
    stop = StopRequested()
    assert not stop
    former = signal.signal(signal.SIGTERM, stop)
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop
    finally:
        signal.signal(signal.SIGTERM, former)


def test_a_server_notes_a_signal_without_a_lock_and_shuts_down_in_its_loop(empty_data_dir: Path) -> None:
    """A second SIGTERM may interrupt the shutdown where it holds the locks that the first one took."""
    settings = Settings(data_dir=empty_data_dir, workers=0, disk_floor_bytes=0, port=0)
    server, listener = HttpServer(settings), listen(settings)
    running = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    running.start()
    wait_until(lambda: server.started or not running.is_alive(), 120.0, "the server listens")
    service = server._app.state.service
    handler = threading.Thread(target=server.handle_exit, args=(signal.SIGTERM, None), daemon=True)
    with service.delivery._sending._wake._cond:
        handler.start()
        handler.join(10.0)
        interrupted = handler.is_alive()
    running.join(120.0)
    assert not interrupted, "a signal handler waits for a lock"
    assert not running.is_alive()
    assert service.stopping
    assert not server.force_exit


def test_clients_that_do_not_read_are_left_at_the_end_without_a_failure(
    empty_data_dir: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(http_server, "_MAX_REQUEST_SHUTDOWN_S", 0.3)
    settings = Settings(data_dir=empty_data_dir, workers=0, disk_floor_bytes=0, port=0)
    server, listener = HttpServer(settings), listen(settings)
    serving = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    serving.start()
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        client.connect(listener.getsockname())
        client.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 40)
        wait_until(lambda: any(one.flow.write_paused for one in _connections(server)), 120, "an answer waits")
        server.should_exit = True
        serving.join(120)
    assert not serving.is_alive()
    assert [record.message for record in caplog.records if record.levelname == "ERROR"] == []


def _connections(server: HttpServer) -> list[Connection]:
    return [one for one in server.server_state.connections if isinstance(one, Connection)]
