"""Keys, doctor and a full disk, as an operator meets them."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx2
import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ClientError, ServiceClient
from tests.support.command_line import gridpose_here
from tests.support.image.images import small_image
from tests.support.service.service import TARGET, gridpose, new_session, put, wait_until

MakeService = Callable[..., ServiceProcess]
FORWARDED = "203.0.113.7"


def new_key(data_dir: Path, scope: str) -> str:
    ended = gridpose_here("keys", "create", "cell 7", "--scope", scope, "--init", "--data-dir", str(data_dir))
    assert ended.returncode == 0, ended.stderr
    return key_in(ended.stdout)


def key_in(said: str) -> str:
    key = said.splitlines()[-1]
    assert re.fullmatch(r"gp_[0-9A-Za-z]+_[0-9A-Za-z]+", key)
    return key


def audited_address(service: ServiceProcess, key: str) -> str:
    """Return the client's address in the audit trail of a request that says it was forwarded."""
    headers = {"Authorization": f"Bearer {key}", "X-Forwarded-For": FORWARDED}
    with httpx2.Client(base_url=service.url, headers=headers) as client:
        made = client.post("/v1/targets", json=TARGET).json()["id"]
        (entry,) = client.get("/v1/audit", params={"object_id": made}).json()["items"]
    return str(entry["client"])


@dataclass(frozen=True)
class Ended:
    """An installation whose first service took one image and ended; tests start others on copies."""

    data_dir: Path
    key: str
    session_id: str
    stored: str
    address: str
    modes: dict[Path, int]
    """Permissions of all files but the log, while the service ran."""

    def copied(self, folder: Path) -> Path:
        return Path(shutil.copytree(self.data_dir, folder))


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    service = ServiceProcess(tmp_path_factory.mktemp("ended") / "data", {"GRIDPOSE_WORKERS": "0"}).start()
    try:
        key = service.admin_key
        assert key is not None
        with ServiceClient(service.url, key) as client:
            session_id = new_session(client)
            stored = put(client, session_id, small_image(1))
        address = audited_address(service, key)
        files = [path for path in service.data_dir.rglob("*") if path.name != "service.log"]
        modes = {path: path.stat().st_mode & 0o777 for path in files}
        assert service.stop() == 0
    finally:
        service.kill()
    return Ended(service.data_dir, key, session_id, stored, address, modes)


@dataclass(frozen=True)
class Running:
    """A service without workers, on a folder where a command had made a key; it trusts a proxy on its machine."""

    service: ServiceProcess
    reader: str
    admin: str


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    data_dir = tmp_path_factory.mktemp("running") / "data"
    made = gridpose("keys", "create", "cell 7", "--scope", "read", "--init", "--data-dir", str(data_dir))
    assert made.returncode == 0, made.stderr
    settings = {"GRIDPOSE_WORKERS": "0", "GRIDPOSE_TRUSTED_PROXIES": "127.0.0.0/8"}
    with ServiceProcess(data_dir, settings) as service:
        yield Running(service, key_in(made.stdout), new_key(data_dir, "admin"))


def test_keys_on_an_empty_folder_and_while_the_service_runs(running: Running) -> None:
    service, data_dir = running.service, str(running.service.data_dir)
    uploader = new_key(service.data_dir, "upload")
    with ServiceClient(service.url, running.reader) as client:
        client.get("/v1/targets")
        with pytest.raises(ClientError) as caught:
            client.create("/v1/targets", TARGET)
        assert caught.value.status == 403
    with ServiceClient(service.url, uploader) as client:
        client.create("/v1/targets", TARGET)

    listed = gridpose_here("keys", "list", "--data-dir", data_dir).stdout
    assert uploader.split("_")[2] not in listed, "the secret is shown once only"
    row = next(line for line in listed.splitlines() if " upload " in line)
    revoked = gridpose("keys", "revoke", row.split()[0], "--data-dir", data_dir)
    assert revoked.returncode == 0, revoked.stderr
    with ServiceClient(service.url, uploader) as client, pytest.raises(ClientError) as caught:
        client.get("/v1/targets")
    assert caught.value.status == 401


def test_commands_make_no_installation_and_say_what_they_used(tmp_path: Path) -> None:
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
        run = gridpose if command == ("worker",) else gridpose_here  # which would run on if it went wrong
        ended = run(*command, "--data-dir", str(folder))
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
    doctor = gridpose_here("doctor", "--data-dir", str(tmp_path / "data"))
    assert doctor.returncode == 1
    assert "GRIDPOSE_KEY_PEPPER" in doctor.stdout
    assert not (tmp_path / "data" / "key-pepper").exists()


def test_what_is_no_key_or_scope_is_refused(tmp_path: Path) -> None:
    new_key(tmp_path / "data", "read")
    data_dir = str(tmp_path / "data")
    assert gridpose_here("keys", "revoke", "key_none", "--data-dir", data_dir).returncode == 1
    assert gridpose_here("keys", "create", "x", "--scope", "owner", "--data-dir", data_dir).returncode == 2
    assert gridpose_here("keys", "create", "", "--data-dir", data_dir).returncode == 2


def test_the_first_admin_key_lies_in_a_file_and_not_in_the_journal(ended: Ended) -> None:
    file = ended.data_dir / "first-admin-key"
    assert file.read_text().strip() == ended.key
    if os.name == "posix":
        assert ended.modes[file] == 0o600
        assert [path for path, mode in ended.modes.items() if mode & 0o077] == [], "closed to other users"
    secret = ended.key.rpartition("_")[2]
    assert secret not in (ended.data_dir / "service.log").read_text()


def test_a_forwarded_address_counts_where_the_proxy_is_trusted(ended: Ended, running: Running) -> None:
    """The server would otherwise believe every program of its own machine."""
    assert ended.address == "127.0.0.1"
    assert audited_address(running.service, running.admin) == FORWARDED


def test_a_later_service_makes_no_key_and_on_a_full_disk_goes_on_reading(
    make_service: MakeService, ended: Ended, tmp_path: Path
) -> None:
    data_dir = ended.copied(tmp_path / "data")
    (data_dir / "first-admin-key").unlink()
    full = make_service(GRIDPOSE_DISK_FLOOR_BYTES=str(2**62), GRIDPOSE_WORKERS="0").start(until_ready=False)
    assert full.admin_key is None, "there is one, wherever it is kept now"
    listed = gridpose_here("keys", "list", "--data-dir", str(data_dir)).stdout
    assert listed.count("first admin key") == 1
    with ServiceClient(full.url, ended.key, retry_for_s=0) as client:
        client.get("/v1/sessions")
        with pytest.raises(ClientError) as caught:
            put(client, ended.session_id, small_image(2))
        assert (caught.value.status, caught.value.code) == (507, "storage_full")
        assert caught.value.advice
        assert client.get_bytes(f"/v1/measurements/{ended.stored}/image") == small_image(1)
    ready = httpx2.get(f"{full.url}/readyz")
    assert ready.status_code == 503
    assert ready.headers["content-type"].startswith("application/problem+json")
    assert httpx2.get(f"{full.url}/livez").status_code == 200


def test_doctor_finds_a_sound_installation_sound_and_its_log_is_json_on_stderr(
    service: ServiceProcess, tmp_path: Path
) -> None:
    examined = gridpose("doctor", "--data-dir", str(service.data_dir))
    assert examined.returncode == 0, examined.stdout + examined.stderr
    assert "SQLite" in examined.stdout
    assert "OpenCV" in examined.stdout
    assert "ins_" in examined.stdout
    assert gridpose_here("version").stdout.strip() in examined.stdout
    absent = gridpose_here("doctor", "--data-dir", str(tmp_path / "not yet there"))
    assert absent.returncode == 1
    assert not (tmp_path / "not yet there").exists(), "looking changes nothing"

    httpx2.get(f"{service.url}/v1/targets")
    assert service.stop() == 0
    log = (service.data_dir / "service.log").read_text(encoding="utf-8").splitlines()
    lines = [json.loads(line) for line in log]
    (request,) = [line for line in lines if line["event"] == "request"]
    assert (request["route"], request["status"], request["level"]) == ("unmatched", 401, "info")


def test_doctor_says_what_to_do_about_what_is_broken(ended: Ended, tmp_path: Path) -> None:
    data_dir = ended.copied(tmp_path / "data")
    full = gridpose_here("doctor", "--data-dir", str(data_dir), GRIDPOSE_DISK_FLOOR_BYTES=str(2**62))
    assert full.returncode == 1
    assert "GRIDPOSE_DISK_FLOOR_BYTES" in full.stdout

    for path in data_dir.glob("gridpose.sqlite3*"):
        path.write_bytes(b"no database" * 1000)
    damaged = gridpose_here("doctor", "--data-dir", str(data_dir))
    assert damaged.returncode == 1, damaged.stdout
    assert "gridpose restore" in " ".join(damaged.stdout.split())


def test_worker_computes_what_a_head_without_workers_took_in(running: Running) -> None:
    head = running.service
    with ServiceClient(head.url, running.admin) as client:
        session_id = new_session(client)
        for number in range(5):
            put(client, session_id, small_image(number))
        worker = subprocess.Popen(
            [sys.executable, "-m", "app.cli", "worker", "--data-dir", str(head.data_dir)],
            env={**os.environ, "GRIDPOSE_WORKERS": "1"},
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            wait_until(
                lambda: client.get(f"/v1/sessions/{session_id}")["counts"]["failed"] == 5,
                120,
                "all done",
            )
        finally:
            worker.terminate()
            _, said = worker.communicate(timeout=120)
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


def test_doctor_outlives_a_lock_that_cannot_be_opened(tmp_path: Path) -> None:
    new_key(tmp_path, "admin")
    (tmp_path / "runner.lock").mkdir()  # as unusable as on a disk that went read-only, and the same to root
    ended = gridpose_here("doctor", "--data-dir", str(tmp_path))
    assert "SQLite" in ended.stdout, "what comes after it is examined"
