"""Keys, doctor and a full disk, as an operator meets them."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import httpx2
import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ClientError, ServiceClient
from tests.support.image.images import small_image
from tests.support.service.service import TARGET, gridpose, new_session, put, wait_until

MakeService = Callable[..., ServiceProcess]


def new_key(data_dir: Path, scope: str) -> str:
    ended = gridpose("keys", "create", "cell 7", "--scope", scope, "--init", "--data-dir", str(data_dir))
    assert ended.returncode == 0, ended.stderr
    key = ended.stdout.splitlines()[-1]
    assert re.fullmatch(r"gp_[0-9A-Za-z]+_[0-9A-Za-z]+", key)
    return key


def test_keys_on_an_empty_folder_and_while_the_service_runs(
    make_service: MakeService, tmp_path: Path
) -> None:
    reader = new_key(tmp_path / "data", "read")
    service = make_service(GRIDPOSE_WORKERS="0").start()
    uploader = new_key(service.data_dir, "upload")
    with ServiceClient(service.url, reader) as client:
        client.get("/v1/targets")
        with pytest.raises(ClientError) as caught:
            client.create("/v1/targets", TARGET)
        assert caught.value.status == 403
    with ServiceClient(service.url, uploader) as client:
        client.create("/v1/targets", TARGET)

    listed = gridpose("keys", "list", "--data-dir", str(service.data_dir)).stdout
    assert uploader.split("_")[2] not in listed, "the secret is shown once only"
    row = next(line for line in listed.splitlines() if " upload " in line)
    ended = gridpose("keys", "revoke", row.split()[0], "--data-dir", str(service.data_dir))
    assert ended.returncode == 0, ended.stderr
    with ServiceClient(service.url, uploader) as client, pytest.raises(ClientError) as caught:
        client.get("/v1/targets")
    assert caught.value.status == 401


def test_commands_make_no_installation_and_say_what_they_used(
    make_service: MakeService, tmp_path: Path
) -> None:
    """A mistyped folder got a database, a pepper and a key of its own, and nobody noticed."""
    folder = tmp_path / "mistyped"
    for command in (
        ("keys", "create", "x"),
        ("keys", "list"),
        ("keys", "revoke", "key_none"),
        ("worker",),
        ("backup", str(tmp_path / "backup")),
        ("schema", "show"),
    ):
        ended = gridpose(*command, "--data-dir", str(folder))
        assert ended.returncode == 2, (command, ended.stderr)
        assert str(folder) in ended.stderr
    assert not folder.exists()
    assert not (tmp_path / "backup").exists()


def test_a_service_does_not_open_what_does_not_belong_together(tmp_path: Path) -> None:
    new_key(tmp_path / "data", "admin")
    (tmp_path / "data" / "key-pepper").unlink()
    served = gridpose("serve", "--port", "0", "--data-dir", str(tmp_path / "data"))
    assert served.returncode == 2
    assert "GRIDPOSE_KEY_PEPPER" in served.stderr
    doctor = gridpose("doctor", "--data-dir", str(tmp_path / "data"))
    assert doctor.returncode == 1
    assert "GRIDPOSE_KEY_PEPPER" in doctor.stdout
    assert not (tmp_path / "data" / "key-pepper").exists()


def test_what_is_no_key_or_scope_is_refused(tmp_path: Path) -> None:
    new_key(tmp_path / "data", "read")
    data_dir = str(tmp_path / "data")
    assert gridpose("keys", "revoke", "key_none", "--data-dir", data_dir).returncode == 1
    assert gridpose("keys", "create", "x", "--scope", "owner", "--data-dir", data_dir).returncode == 2
    assert gridpose("keys", "create", "", "--data-dir", data_dir).returncode == 2


def test_the_first_admin_key_lies_in_a_file_and_not_in_the_journal(make_service: MakeService) -> None:
    first = make_service(GRIDPOSE_WORKERS="0").start()
    key = first.admin_key
    assert key is not None
    file = first.data_dir / "first-admin-key"
    assert file.read_text().strip() == key
    if os.name == "posix":
        assert file.stat().st_mode & 0o777 == 0o600
        made = [path for path in first.data_dir.rglob("*") if path.name != "service.log"]
        assert [path for path in made if path.stat().st_mode & 0o077] == [], "closed to other users"
    with ServiceClient(first.url, key) as client:
        client.get("/v1/sessions")
    assert first.stop() == 0
    secret = key.rpartition("_")[2]
    assert secret not in (first.data_dir / "service.log").read_text()

    file.unlink()
    second = make_service(GRIDPOSE_WORKERS="0").start()
    assert second.admin_key is None, "there is one, wherever it is kept now"
    listed = gridpose("keys", "list", "--data-dir", str(second.data_dir)).stdout
    assert listed.count("first admin key") == 1
    with ServiceClient(second.url, key) as client:
        client.get("/v1/sessions")


@pytest.mark.parametrize(("trusted", "expected"), [("", "127.0.0.1"), ("127.0.0.0/8", "203.0.113.7")])
def test_a_forwarded_address_counts_where_the_proxy_is_trusted(
    make_service: MakeService, trusted: str, expected: str
) -> None:
    """The server would otherwise believe every program of its own machine."""
    service = make_service(GRIDPOSE_TRUSTED_PROXIES=trusted, GRIDPOSE_WORKERS="0").start()
    headers = {"Authorization": f"Bearer {service.admin_key}", "X-Forwarded-For": "203.0.113.7"}
    made = httpx2.post(f"{service.url}/v1/targets", json=TARGET, headers=headers).json()["id"]
    address = f"{service.url}/v1/audit?object_id={made}"
    (entry,) = httpx2.get(address, headers=headers).json()["items"]
    assert entry["client"] == expected


def test_a_full_disk_refuses_uploads_and_goes_on_reading(make_service: MakeService) -> None:
    service = make_service(GRIDPOSE_WORKERS="0").start()
    key = service.admin_key
    data, late = small_image(1), small_image(2)
    with ServiceClient(service.url, key) as client:
        session_id = new_session(client)
        stored = put(client, session_id, data)
    service.stop()

    full = make_service(GRIDPOSE_DISK_FLOOR_BYTES=str(2**62), GRIDPOSE_WORKERS="0").start(until_ready=False)
    with ServiceClient(full.url, key, retry_for_s=0) as client:
        with pytest.raises(ClientError) as caught:
            put(client, session_id, late)
        assert (caught.value.status, caught.value.code) == (507, "storage_full")
        assert caught.value.advice
        assert client.get_bytes(f"/v1/measurements/{stored}/image") == data
    ready = httpx2.get(f"{full.url}/readyz")
    assert ready.status_code == 503
    assert ready.headers["content-type"].startswith("application/problem+json")
    assert httpx2.get(f"{full.url}/livez").status_code == 200


def test_doctor_finds_a_sound_installation_sound(service: ServiceProcess, tmp_path: Path) -> None:
    ended = gridpose("doctor", "--data-dir", str(service.data_dir))
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "SQLite" in ended.stdout
    assert "OpenCV" in ended.stdout
    assert "ins_" in ended.stdout
    assert gridpose("version").stdout.strip() in ended.stdout
    ended = gridpose("doctor", "--data-dir", str(tmp_path / "not yet there"))
    assert ended.returncode == 1
    assert not (tmp_path / "not yet there").exists(), "looking changes nothing"


def test_doctor_says_what_to_do_about_what_is_broken(make_service: MakeService) -> None:
    service = make_service(GRIDPOSE_WORKERS="0").start()
    service.stop()
    full = gridpose("doctor", "--data-dir", str(service.data_dir), GRIDPOSE_DISK_FLOOR_BYTES=str(2**62))
    assert full.returncode == 1
    assert "GRIDPOSE_DISK_FLOOR_BYTES" in full.stdout

    for path in service.data_dir.glob("gridpose.sqlite3*"):
        path.write_bytes(b"no database" * 1000)
    damaged = gridpose("doctor", "--data-dir", str(service.data_dir))
    assert damaged.returncode == 1, damaged.stdout
    assert "gridpose restore" in " ".join(damaged.stdout.split())


def test_worker_computes_what_a_head_without_workers_took_in(make_service: MakeService) -> None:
    head = make_service(GRIDPOSE_WORKERS="0").start()
    with ServiceClient(head.url, head.admin_key) as client:
        session_id = new_session(client)
        for number in range(5):
            data = small_image(number)
            put(client, session_id, data)
        worker = subprocess.Popen(
            [sys.executable, "-m", "app.cli", "worker", "--data-dir", str(head.data_dir)],
            env={**os.environ, "GRIDPOSE_WORKERS": "1"},
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            wait_until(
                lambda: client.get(f"/v1/sessions/{session_id}")["counts"]["failed"] == 5, 60, "all done"
            )
        finally:
            worker.terminate()
            _, said = worker.communicate(timeout=25)
    assert worker.returncode == 0, said


def test_version_and_help_load_nothing_of_the_service() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*\+[0-9a-f]{12}\n", gridpose("version").stdout)
    script = (
        "import sys, app.client.commands.images.upload, app.cli.main\n"
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
    assert "SQLite" in ended.stdout, "what comes after it is examined"
