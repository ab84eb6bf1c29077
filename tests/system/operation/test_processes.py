"""The service's processes: an orderly end, a killed head, a worker that dies, a port and a folder in use."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable
from pathlib import Path

import httpx2
import pytest

from app.cli.demo.service_process import ServiceProcess, ServiceStartError
from app.client import ServiceClient
from tests.support.environment.processes import cpu_seconds, descendants, is_alive, worker_processes
from tests.support.image.images import slow_image, small_image
from tests.support.service.service import gridpose, new_session, put, wait_until

MakeService = Callable[..., ServiceProcess]


def test_sigterm_ends_everything_in_time_and_the_rest_is_done_after_a_restart(
    make_service: MakeService,
) -> None:
    """Then the service is killed, takes its workers along, and is ready again."""
    service = make_service().start()
    key = service.admin_key
    with ServiceClient(service.url, key) as client:
        session_id = new_session(client)
        for number in range(60):
            put(client, session_id, small_image(number))
        # A listener that would stay permanently must not keep the service from ending.
        with httpx2.stream(
            "GET",
            f"{service.url}/v1/sessions/{session_id}/events",
            headers={"Authorization": f"Bearer {key}"},
            timeout=40,
        ) as events:
            assert events.status_code == 200
            children = descendants(service.process.pid)
            assert children
            assert service.stop() == 0  # within STOP_WITHIN_S
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children), 120, "workers gone")

    service = make_service(GRIDPOSE_WORKERS="2").start()
    with ServiceClient(service.url, key) as client:

        def counts() -> dict[str, int]:
            found: dict[str, int] = client.get(f"/v1/sessions/{session_id}")["counts"]
            return found

        wait_until(lambda: counts()["failed"] == 60, 120, "all images done after the restart")
        measurements = list(client.items(f"/v1/sessions/{session_id}/measurements"))
        assert {m["failure"]["code"] for m in measurements} == {"target_not_found"}

    children = descendants(service.process.pid)
    assert len(children) >= 2
    service.kill()
    wait_until(lambda: not any(is_alive(pid) for pid in children), 120, "workers gone")
    make_service().start(ready_within_s=120)  # 40 s on a machine with nothing else to do


def test_an_image_whose_worker_dies_three_times_is_given_up_and_the_others_finish(
    service: ServiceProcess,
) -> None:
    """The worker is killed from outside whenever it computes the one image, as the system's memory guard would."""
    with (
        ServiceClient(service.url, service.admin_key) as client,
        httpx2.Client(base_url=service.url) as anyone,
    ):
        session_id = new_session(client)
        poison = put(client, session_id, slow_image(), "poison")
        others = [put(client, session_id, small_image(number)) for number in range(5)]

        def attempts_and_status() -> tuple[int, str]:
            m = client.get(f"/v1/measurements/{poison}")
            return m["attempts"], m["status"]

        def is_ready() -> bool:  # a worker that has started, and waits for a job or computes one
            return anyone.get("/readyz").status_code == 200

        # Once per attempt: a service whose worker is also killed at every start can compute nothing, and ends.
        # A claimed image is `running` while it waits for a worker that starts; a death at the start is no attempt.
        for ended in range(3):
            running = (ended, "running")
            wait_until(lambda now=running: attempts_and_status() == now, 120, f"{ended} attempts ended")
            wait_until(is_ready, 120, "a worker has started")
            (worker,) = worker_processes(service.process.pid)
            before = cpu_seconds(worker)
            wait_until(lambda pid=worker, s=before: cpu_seconds(pid) > s + 0.1, 120, "it computes")
            os.kill(worker, signal.SIGKILL)

        wait_until(
            lambda: attempts_and_status()[1] not in ("queued", "running"),
            120,
            "the image is given up",
        )
        failure = client.get(f"/v1/measurements/{poison}")["failure"]
        assert failure["code"] == "worker_crashed"
        assert failure["advice"]
        assert attempts_and_status()[0] == 3

        def ends() -> set[tuple[str, str]]:
            found = [client.get(f"/v1/measurements/{other}") for other in others]
            return {(m["status"], (m["failure"] or {}).get("code", "")) for m in found}

        wait_until(
            lambda: ends() == {("failed", "target_not_found")},
            120,
            "the other images are done",
        )

        wait_until(is_ready, 120, "the worker that died last is replaced")


def test_a_second_service_on_the_same_folder_is_refused_in_a_sentence(make_service: MakeService) -> None:
    service = make_service(GRIDPOSE_WORKERS="0").start()
    with pytest.raises(ServiceStartError, match="ended with code"):
        make_service().start()
    assert httpx2.get(f"{service.url}/readyz").status_code == 200


def test_a_service_that_is_not_ready_in_time_says_what_to_do(tmp_path: Path) -> None:
    full = {"GRIDPOSE_WORKERS": "0", "GRIDPOSE_DISK_FLOOR_BYTES": str(2**62)}  # and never ready
    for within_s in (0.1, 10.0):
        with pytest.raises(ServiceStartError) as refused:
            ServiceProcess(tmp_path / "data", full).start(ready_within_s=within_s)
        text = str(refused.value)
        assert text.startswith(f"The service was not ready within {within_s:.0f} s. ")
        assert "do the same again" in text
    assert "{" not in text


def test_a_port_in_use_is_said_to_be_that(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        ended = gridpose("serve", "--port", port, "--data-dir", str(tmp_path / "d"))
    assert ended.returncode == 1
    assert port in ended.stderr


def test_an_open_service_is_refused_off_the_loopback_address(tmp_path: Path) -> None:
    ended = gridpose(
        "serve", "--host", "0.0.0.0", "--port", "0", "--data-dir", str(tmp_path / "d"), GRIDPOSE_AUTH="off"
    )
    assert ended.returncode == 2
    assert "loopback" in ended.stderr
    assert not (tmp_path / "d").exists()


def test_a_folder_that_cannot_be_made_is_said_to_be_that(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    ended = gridpose("serve", "--port", "0", "--data-dir", str(tmp_path / "file" / "data"))
    assert ended.returncode == 1
    assert str(tmp_path / "file") in ended.stderr


def test_bad_settings_are_named(tmp_path: Path) -> None:
    ended = gridpose("serve", "--port", "0", "--data-dir", str(tmp_path / "d"), GRIDPOSE_WORKERS="many")
    assert ended.returncode == 2
    assert "GRIDPOSE_WORKERS" in ended.stderr
