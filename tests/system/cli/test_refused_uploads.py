"""What the system or the client does not let the service store is refused at once and leaves nothing behind."""

from __future__ import annotations

import hashlib
import http.client
import json
import socket
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from tests.support.image.images import small_image
from tests.support.service.service import TARGET, new_session, wait_until


@pytest.fixture(scope="module")
def head(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """One service without workers for all tests here, each with a session of its own."""
    folder = tmp_path_factory.mktemp("refused") / "data"
    with ServiceProcess(folder, {"GRIDPOSE_WORKERS": "0", "GRIDPOSE_DISK_FLOOR_BYTES": "0"}) as service:
        yield service


@pytest.fixture
def session_id(head: ServiceProcess) -> str:
    with ServiceClient(head.url, head.admin_key) as client:
        return new_session(client)


def port_of(service: ServiceProcess) -> int:
    return int(service.url.rpartition(":")[2])


def originals(service: ServiceProcess) -> list[str]:
    return sorted(path.name for path in (service.data_dir / "originals").rglob("*") if path.is_file())


@pytest.fixture
def before(head: ServiceProcess) -> list[str]:
    """The files that lie there before a test."""
    return originals(head)


@pytest.mark.skipif(sys.platform != "linux", reason="needs prlimit")
def test_a_limit_of_file_sizes_is_answered_like_a_full_disk(
    head: ServiceProcess, session_id: str, before: list[str]
) -> None:
    """On one connection throughout, with the log on a file that the limit holds for, too."""
    import resource

    pid = head.process.pid
    unlimited = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    connection = http.client.HTTPConnection("127.0.0.1", port_of(head), timeout=60)
    connection.connect()
    first = connection.sock
    assert first is not None
    kept = list(before)

    def send(method: str, address: str, body: bytes, kind: str) -> tuple[int, Any]:
        headers = {"Authorization": f"Bearer {head.admin_key}", "Content-Type": kind}
        connection.request(method, address, body, headers)
        answer = connection.getresponse()
        document = json.loads(answer.read())
        media_type = "application/json" if answer.status < 400 else "application/problem+json"
        assert answer.headers["content-type"].startswith(media_type)
        assert connection.sock is first, "the connection was closed"
        return answer.status, document

    def put(data: bytes) -> tuple[int, Any]:
        sha256 = hashlib.sha256(data).hexdigest()
        address = f"/v1/sessions/{session_id}/poses/P1/images/{sha256}"
        status, document = send("PUT", address, data, "application/octet-stream")
        if status == 202:
            kept.append(sha256)
        return status, document

    with first:
        assert put(small_image(0))[0] == 202
        for limit in (1 << 20, 60_000, 4096, 100, 0):
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (limit, unlimited[1]))
            status, problem = put(small_image(1) + bytes(4 << 20))
            assert (status, problem["code"]) == (507, "storage_full")
            if limit < 1 << 20:
                for attempt in (
                    put(small_image(2)),
                    send("POST", "/v1/targets", json.dumps(TARGET).encode(), "application/json"),
                ):
                    assert (attempt[0], attempt[1]["code"]) == (507, "storage_full")
        resource.prlimit(pid, resource.RLIMIT_FSIZE, unlimited)
        assert put(small_image(3))[0] == 202
    assert originals(head) == sorted(kept)


@pytest.mark.parametrize("more", ["", "Expect: 100-continue\r\n"])
def test_a_terabyte_that_is_announced_is_refused_at_once(
    head: ServiceProcess, session_id: str, before: list[str], more: str
) -> None:
    address = f"/v1/sessions/{session_id}/poses/P1/images/{'0' * 64}"
    request = f"PUT {address} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {head.admin_key}\r\n"
    request += f"Content-Type: application/octet-stream\r\nContent-Length: {10**12}\r\n{more}\r\n"
    with socket.create_connection(("127.0.0.1", port_of(head)), timeout=60) as connection:
        connection.sendall(request.encode())
        answer = connection.recv(65536)
        while b'"code"' not in answer:
            answer += connection.recv(65536)
    assert answer.startswith(b"HTTP/1.1 413")  # no byte of the body was sent: it did not wait for one
    assert b'"upload_too_large"' in answer
    assert originals(head) == before


def test_a_client_that_goes_away_leaves_no_file(
    head: ServiceProcess, session_id: str, before: list[str]
) -> None:
    address = f"/v1/sessions/{session_id}/poses/P1/images/{'0' * 64}"
    request = f"PUT {address} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {head.admin_key}\r\n"
    request += "Content-Type: application/octet-stream\r\nContent-Length: 9000000\r\n\r\n"
    with socket.create_connection(("127.0.0.1", port_of(head)), timeout=60) as connection:
        connection.sendall(request.encode() + bytes(3 << 20))
        wait_until(lambda: len(originals(head)) == len(before) + 1, 120, "the upload is being received")
    wait_until(lambda: originals(head) == before, 120, "nothing is left of it")
