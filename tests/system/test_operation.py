"""Keys, doctor and a full disk, as an operator meets them."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import httpx2
import pytest

from app.agent import ClientError, ServiceClient
from app.cli.process import ServiceProcess

MakeService = Callable[..., ServiceProcess]


def gridpose(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "app.cli", *arguments],
        env={**os.environ, "COLUMNS": "160", **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def new_key(data_dir: Path, scope: str) -> str:
    ended = gridpose("keys", "create", "cell 7", "--scope", scope, "--data-dir", str(data_dir))
    assert ended.returncode == 0, ended.stderr
    key = ended.stdout.splitlines()[-1]
    assert re.fullmatch(r"gp_[0-9A-Za-z]+_[0-9A-Za-z]+", key)
    return key


def test_keys_on_an_empty_folder_and_while_the_service_runs(
    make_service: MakeService, tmp_path: Path
) -> None:
    reader = new_key(tmp_path / "data", "read")
    service = make_service().start()
    uploader = new_key(service.data_dir, "upload")
    body = {"name": "b", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
    with ServiceClient(service.url, reader) as client:
        client.get("/v1/targets")
        with pytest.raises(ClientError) as caught:
            client.create("/v1/targets", body)
        assert caught.value.status == 403
    with ServiceClient(service.url, uploader) as client:
        client.create("/v1/targets", body)

    listed = gridpose("keys", "list", "--data-dir", str(service.data_dir)).stdout
    assert uploader.split("_")[2] not in listed, "the secret is shown once only"
    row = next(line for line in listed.splitlines() if " upload " in line)
    ended = gridpose("keys", "revoke", row.split()[0], "--data-dir", str(service.data_dir))
    assert ended.returncode == 0, ended.stderr
    with ServiceClient(service.url, uploader) as client, pytest.raises(ClientError) as caught:
        client.get("/v1/targets")
    assert caught.value.status == 401


def test_what_is_no_key_or_scope_is_refused(tmp_path: Path) -> None:
    data_dir = str(tmp_path / "data")
    assert gridpose("keys", "revoke", "key_none", "--data-dir", data_dir).returncode == 1
    assert gridpose("keys", "create", "x", "--scope", "owner", "--data-dir", data_dir).returncode == 2
    assert gridpose("keys", "create", "", "--data-dir", data_dir).returncode == 2


def test_the_first_start_alone_prints_an_admin_key(make_service: MakeService) -> None:
    first = make_service().start()
    key = first.admin_key
    assert key is not None
    assert first.stop() == 0
    second = make_service().start()
    assert second.admin_key is None
    with ServiceClient(second.url, key) as client:
        client.get("/v1/sessions")


def test_a_full_disk_refuses_uploads_and_goes_on_reading(
    make_service: MakeService, small_image: Callable[[int], bytes]
) -> None:
    service = make_service().start()
    key = service.admin_key
    target = {"name": "b", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
    data, late = small_image(1), small_image(2)
    with ServiceClient(service.url, key) as client:
        target_id = client.create("/v1/targets", target)["id"]
        session_id = client.create("/v1/sessions", {"name": "s", "target_ids": [target_id]})["id"]
        stored = client.put_image(session_id, "P1", hashlib.sha256(data).hexdigest(), data)["id"]
    service.stop()

    full = make_service(GRIDPOSE_DISK_FLOOR_BYTES=str(2**62), GRIDPOSE_WORKERS="0").start(until_ready=False)
    with ServiceClient(full.url, key, retry_for_s=0) as client:
        with pytest.raises(ClientError) as caught:
            client.put_image(session_id, "P1", hashlib.sha256(late).hexdigest(), late)
        assert (caught.value.status, caught.value.code) == (507, "storage_full")
        assert caught.value.advice
        assert client.get_bytes(f"/v1/measurements/{stored}/image") == data
    ready = httpx2.get(f"{full.url}/readyz")
    assert ready.status_code == 503
    assert ready.headers["content-type"].startswith("application/problem+json")
    assert httpx2.get(f"{full.url}/livez").status_code == 200


def test_doctor_finds_a_sound_installation_sound(service: ServiceProcess, tmp_path: Path) -> None:
    for data_dir in (service.data_dir, tmp_path / "not yet there"):
        ended = gridpose("doctor", "--data-dir", str(data_dir))
        assert ended.returncode == 0, ended.stdout + ended.stderr
        assert "SQLite" in ended.stdout
        assert "OpenCV" in ended.stdout
    assert not (tmp_path / "not yet there").exists(), "looking changes nothing"


def test_doctor_says_what_to_do_about_what_is_broken(make_service: MakeService) -> None:
    service = make_service().start()
    service.stop()
    full = gridpose("doctor", "--data-dir", str(service.data_dir), GRIDPOSE_DISK_FLOOR_BYTES=str(2**62))
    assert full.returncode == 1
    assert "GRIDPOSE_DISK_FLOOR_BYTES" in full.stdout

    for path in service.data_dir.glob("gridpose.sqlite3*"):
        path.write_bytes(b"no database" * 1000)
    damaged = gridpose("doctor", "--data-dir", str(service.data_dir))
    assert damaged.returncode == 1, damaged.stdout
    assert "backups" in damaged.stdout
    assert "Traceback" not in damaged.stderr


def test_worker_computes_what_a_head_without_workers_took_in(
    make_service: MakeService, small_image: Callable[[int], bytes], until: Callable[..., None]
) -> None:
    head = make_service(GRIDPOSE_WORKERS="0").start()
    target = {"name": "b", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
    with ServiceClient(head.url, head.admin_key) as client:
        target_id = client.create("/v1/targets", target)["id"]
        session_id = client.create("/v1/sessions", {"name": "s", "target_ids": [target_id]})["id"]
        for number in range(5):
            data = small_image(number)
            client.put_image(session_id, "P1", hashlib.sha256(data).hexdigest(), data)
        worker = subprocess.Popen(
            [sys.executable, "-m", "app.cli", "worker", "--data-dir", str(head.data_dir)],
            env={**os.environ, "GRIDPOSE_WORKERS": "1"},
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            until(lambda: client.get(f"/v1/sessions/{session_id}")["counts"]["failed"] == 5, 60, "all done")
        finally:
            worker.terminate()
            _, said = worker.communicate(timeout=25)
    assert worker.returncode == 0, said


def test_version_and_help_load_nothing_of_the_service() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*\n", gridpose("version").stdout)
    script = (
        "import sys, app.cli.upload, app.cli.commands\n"
        "loaded = {'sqlalchemy', 'fastapi', 'cv2'} & set(sys.modules)\n"
        "sys.exit(', '.join(loaded) or 0)"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr


def test_the_log_is_json_on_stderr(make_service: MakeService) -> None:
    service = make_service().start()
    httpx2.get(f"{service.url}/v1/targets")
    assert service.stop() == 0
    log = (service.data_dir / "service.log").read_text(encoding="utf-8").splitlines()
    lines = [json.loads(line) for line in log]
    (request,) = [line for line in lines if line["event"] == "request"]
    assert (request["route"], request["status"], request["level"]) == ("unmatched", 401, "info")


def test_doctor_outlives_a_lock_that_cannot_be_opened(tmp_path: Path) -> None:
    new_key(tmp_path, "admin")
    (tmp_path / "runner.lock").mkdir()  # as unusable as on a disk that went read-only, and the same to root
    ended = gridpose("doctor", "--data-dir", str(tmp_path))
    assert "nothing runs on this folder" in ended.stdout
    assert "Traceback" not in ended.stderr
