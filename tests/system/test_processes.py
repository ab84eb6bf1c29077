"""The service's processes: an orderly end, a killed head, a worker that dies, a port and a folder in use."""

from __future__ import annotations

import hashlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import cv2
import httpx2
import numpy as np
import pytest

from app.agent import ServiceClient
from app.cli.process import ServiceProcess, ServiceStartError

Descendants = Callable[[int], set[int]]
Until = Callable[..., None]
MakeService = Callable[..., ServiceProcess]


def new_session(client: ServiceClient) -> str:
    target = {"name": "board", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
    target_id = client.create("/v1/targets", target)["id"]
    session_id: str = client.create("/v1/sessions", {"name": "shift", "target_ids": [target_id]})["id"]
    return session_id


def put(client: ServiceClient, session_id: str, data: bytes, pose_id: str = "P1") -> str:
    sha256 = hashlib.sha256(data).hexdigest()
    measurement_id: str = client.put_image(session_id, pose_id, sha256, data)["id"]
    return measurement_id


def test_sigterm_ends_everything_in_time_and_the_rest_is_done_after_a_restart(
    make_service: MakeService, small_image: Callable[[int], bytes], descendants: Descendants, until: Until
) -> None:
    service = make_service().start()
    key = service.admin_key
    with ServiceClient(service.url, key) as client:
        session_id = new_session(client)
        for number in range(60):
            put(client, session_id, small_image(number))
        # A listener that would stay for ever must not keep the service from ending.
        with httpx2.stream(
            "GET",
            f"{service.url}/v1/sessions/{session_id}/events",
            headers={"Authorization": f"Bearer {key}"},
            timeout=40,
        ) as events:
            assert events.status_code == 200
            children = descendants(service.process.pid)
            assert children
            started = time.monotonic()
            assert service.stop() == 0
            assert time.monotonic() - started <= 25
    until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children), 5, "workers gone")

    service = make_service().start()
    with ServiceClient(service.url, key) as client:

        def counts() -> dict[str, int]:
            found: dict[str, int] = client.get(f"/v1/sessions/{session_id}")["counts"]
            return found

        until(lambda: counts()["failed"] == 60, 60, "all images done after the restart")
        measurements = list(client.items(f"/v1/sessions/{session_id}/measurements"))
        assert {m["failure"]["code"] for m in measurements} == {"target_not_found"}


def test_a_killed_head_takes_its_workers_along_and_a_restart_is_ready(
    make_service: MakeService, descendants: Descendants, until: Until
) -> None:
    service = make_service(GRIDPOSE_WORKERS="2").start()
    children = descendants(service.process.pid)
    assert len(children) >= 2
    service.kill()
    until(lambda: not any(is_alive(pid) for pid in children), 15, "workers gone")
    make_service(GRIDPOSE_WORKERS="2").start(ready_within_s=40)


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_an_image_whose_worker_dies_three_times_is_given_up_and_the_others_finish(
    make_service: MakeService, small_image: Callable[[int], bytes], descendants: Descendants, until: Until
) -> None:
    """The worker is killed from outside whenever it computes the one image, as the system's memory guard would."""
    service = make_service().start()
    with ServiceClient(service.url, service.admin_key) as client:
        session_id = new_session(client)
        poison = put(client, session_id, slow_image(), "poison")
        others = [put(client, session_id, small_image(number)) for number in range(5)]

        def attempts_and_status() -> tuple[int, str]:
            m = client.get(f"/v1/measurements/{poison}")
            return m["attempts"], m["status"]

        deadline = time.monotonic() + 120
        while attempts_and_status()[1] in ("queued", "running"):
            assert time.monotonic() < deadline, "the image was never given up"
            for pid in descendants(service.process.pid):
                if cpu_seconds(pid) > 0.05 and attempts_and_status()[1] == "running":
                    with suppress(ProcessLookupError):  # it may have gone since the list was made
                        os.kill(pid, signal.SIGKILL)
            time.sleep(0.05)
        failure = client.get(f"/v1/measurements/{poison}")["failure"]
        assert failure["code"] == "worker_crashed"
        assert failure["advice"]
        assert attempts_and_status()[0] == 3

        def ends() -> set[tuple[str, str]]:
            found = [client.get(f"/v1/measurements/{other}") for other in others]
            return {(m["status"], (m["failure"] or {}).get("code", "")) for m in found}

        until(lambda: ends() == {("failed", "target_not_found")}, 60, "the other images are done")
        assert httpx2.get(f"{service.url}/readyz").status_code == 200


def slow_image() -> bytes:
    """A progressive JPEG of noise: a few MB that take seconds to decode."""
    tile = np.random.default_rng(5).integers(0, 256, (1000, 1000), dtype=np.uint8)
    picture = np.tile(tile, (9, 10))
    written, data = cv2.imencode(
        ".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 40, cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    )
    assert written
    return data.tobytes()


def cpu_seconds(pid: int) -> float:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_a_second_service_on_the_same_folder_is_refused_in_a_sentence(
    service: ServiceProcess, make_service: MakeService
) -> None:
    with pytest.raises(ServiceStartError, match="Another `gridpose serve` uses"):
        make_service().start()
    assert httpx2.get(f"{service.url}/readyz").status_code == 200


def serve(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "app.cli", "serve", *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_a_port_in_use_is_said_to_be_that(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        ended = serve("--port", port, "--data-dir", str(tmp_path / "d"))
    assert ended.returncode == 1
    assert f"port {port}" in ended.stderr
    assert "Traceback" not in ended.stderr + ended.stdout


def test_an_open_service_is_refused_off_the_loopback_address(tmp_path: Path) -> None:
    ended = serve("--host", "0.0.0.0", "--port", "0", "--data-dir", str(tmp_path / "d"), GRIDPOSE_AUTH="off")
    assert ended.returncode == 2
    assert "loopback" in ended.stderr
    assert not (tmp_path / "d").exists()


def test_a_folder_that_cannot_be_made_is_said_to_be_that(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    ended = serve("--port", "0", "--data-dir", str(tmp_path / "file" / "data"))
    assert ended.returncode == 1
    assert "cannot be used" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_bad_settings_are_named(tmp_path: Path) -> None:
    ended = serve("--port", "0", "--data-dir", str(tmp_path / "d"), GRIDPOSE_WORKERS="many")
    assert ended.returncode == 2
    assert "GRIDPOSE_WORKERS" in ended.stderr
