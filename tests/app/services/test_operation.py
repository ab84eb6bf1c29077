"""Health, metrics, documentation, headers, logs."""

from __future__ import annotations

import json
import re
import shutil
import socket
import sqlite3
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

import app
from app.analyses.service import AnalysisService
from app.blobs.local import LocalBlobs
from app.errors import Unavailable
from app.jobs.painting import ImagePainter
from app.logs import configure_logging
from app.main import AlreadyServed
from app.records.database import Database
from app.records.database.lending import LendingPool
from app.services import health
from app.services.health import CACHED_S
from app.services.maintenance.chores import Maintenance


def test_the_service_says_that_it_lives_and_is_ready(any_api: Any) -> None:
    assert any_api.client.get("/livez").json() == {"status": "ok"}
    ready = any_api.client.get("/readyz")
    assert ready.status_code == 200
    document = ready.json()
    assert [check["name"] for check in document["checks"]] == ["database", "migrations", "disk", "runner"]
    assert all(check["ok"] for check in document["checks"])
    assert "GRIDPOSE_WORKERS=0" in document["checks"][3]["detail"]


def test_without_a_valid_key_readiness_is_a_word(any_api: Any) -> None:
    for key in ("", "Bearer nonsense", f"Bearer gp_{'0' * 26}_{'0' * 64}"):
        answer = any_api.client.get("/readyz", headers={"Authorization": key})
        assert (answer.status_code, answer.json()) == (200, {"status": "ok"})
    any_api.installation.database.dispose()
    read = any_api.client.get("/readyz", headers=any_api.key("read"))
    assert set(read.json()) == {"status", "version", "checks"}


def test_what_fails_is_named_to_those_with_a_key(open_api: Any) -> None:
    with open_api(disk_floor_bytes=2**62) as running:
        named = running.client.get("/readyz")
        unnamed = running.client.get("/readyz", headers={"Authorization": ""})
    assert (named.status_code, unnamed.status_code) == (503, 503)
    assert [error["field"] for error in named.json()["errors"]] == ["disk"]
    assert unnamed.json()["errors"] == []
    assert "bytes" not in unnamed.json()["detail"]


def test_however_many_ask_the_database_is_looked_at_once_in_two_seconds(api: Any) -> None:
    seen: list[str] = []

    def note(*arguments: Any) -> None:
        seen.append(arguments[2])

    sa.event.listen(sa.Engine, "before_cursor_execute", note)
    try:
        started = time.monotonic()
        with ThreadPoolExecutor(8) as pool:
            asked = [pool.submit(api.client.get, "/readyz") for _ in range(64)]
            assert {one.result().status_code for one in asked} == {200}
        most = 1 + (time.monotonic() - started) // CACHED_S
    finally:
        sa.event.remove(sa.Engine, "before_cursor_execute", note)
    assert 1 <= len([one for one in seen if one.startswith("DELETE FROM api_keys")]) <= most


@pytest.mark.slow
def test_readiness_does_not_wait_for_a_long_write(serve_api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with serve_api() as api:
        assert api.client.get("/readyz").status_code == 200
        written = threading.Event()

        def write() -> None:
            with api.installation.database.write() as records:
                records.execute(sa.select(1))
                written.wait(60.0)

        writing = threading.Thread(target=write)
        writing.start()
        time.sleep(CACHED_S + 0.5)
        assert api.client.get("/readyz").status_code == 200
        assert writing.is_alive(), "the answer came before the write ended"
        monkeypatch.setattr(health, "SILENT_S", 1.0)
        silent = api.client.get("/readyz")
        assert silent.status_code == 503
        assert [error["field"] for error in silent.json()["errors"]] == ["database"]
        written.set()
        writing.join()
        deadline = time.monotonic() + 60.0
        while api.client.get("/readyz").status_code != 200:
            assert time.monotonic() < deadline


def test_a_disk_that_cannot_be_reached_is_said_to_be_that(api: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: object) -> int:
        raise FileNotFoundError(2, "No such file or directory")

    monkeypatch.setattr(LocalBlobs, "free_bytes", fail)
    answer = api.client.get("/readyz")
    assert answer.status_code == 503
    assert [error["field"] for error in answer.json()["errors"]] == ["disk"]


@pytest.mark.slow
def test_a_runner_is_ready_after_its_workers_start_and_not_after_its_stop(open_api: Any) -> None:
    with open_api(workers=1) as running:
        deadline = time.monotonic() + 120.0
        while (starting := running.client.get("/readyz")).status_code != 200:
            assert starting.json()["code"] == "not_ready"
            assert "0 of 1 worker processes are ready" in starting.json()["detail"]
            assert time.monotonic() < deadline
        running.service.runner.stop()
        response = running.client.get("/readyz")
        assert response.status_code == 503
        assert response.headers["content-type"] == "application/problem+json"
        assert [error["field"] for error in response.json()["errors"]] == ["runner"]


def test_a_data_folder_is_served_once(open_api: Any) -> None:
    with (
        open_api() as running,
        pytest.raises(AlreadyServed),
        open_api(running.installation.settings.data_dir),
    ):
        pass


def test_a_part_that_cannot_be_stopped_keeps_no_other_from_it(
    open_api: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: object) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch, open_api() as running:
        for part in (Maintenance, ImagePainter, AnalysisService):
            patch.setattr(part, "stop" if part is Maintenance else "close", fail)
    with open_api(running.installation.settings.data_dir):
        pass  # the lock was freed


def test_metrics_count_requests_by_route_and_measurements_by_status(api: Any, grey_png: bytes) -> None:
    api.put_image(api.make_session(), grey_png)
    api.client.get("/v1/sessions/none")
    response = api.client.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain")
    assert 'gridpose_measurements{status="queued"} 1.0' in response.text
    assert 'route="/v1/sessions/{session_id}",status="404"} 1.0' in response.text
    assert "none" not in response.text
    assert "gridpose_disk_free_bytes" in response.text
    assert 'gridpose_analyses{state="waiting"} 0.0' in response.text


def test_answers_carry_an_id_and_guards(api: Any) -> None:
    answer = api.client.get("/v1/targets", headers={"X-Request-ID": "line-4.job_7"})
    assert answer.headers["x-request-id"] == "line-4.job_7"
    assert answer.headers["x-content-type-options"] == "nosniff"
    hostile = api.client.get("/v1/targets", headers={"X-Request-ID": "a b;c" * 100})
    assert re.fullmatch(r"[0-9a-f]{16}", hostile.headers["x-request-id"])


def test_the_documentation_needs_no_other_host(api: Any) -> None:
    page = api.client.get("/docs").text
    references = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert "/docs/swagger-ui-bundle.js" in references
    for reference in references:
        assert reference.startswith(("/docs/", "/openapi.json", "data:"))
        if reference.startswith("/"):
            assert api.client.get(reference).status_code == 200
    assert "'self'" in api.client.get("/docs").headers["content-security-policy"]
    styles = api.client.get("/docs/swagger-ui.css").text
    assert not re.search(r"(@import|url\()\s*[\"']?(https?:)?//", styles)
    licence = Path(app.__file__).parent / "web" / "docs" / "LICENSE.swagger-ui"
    assert "Apache License" in licence.read_text()


@pytest.mark.usefixtures("restored_logging")
def test_the_log_is_json_and_holds_no_secret(api: Any, capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging("info")
    api.client.get("/v1/targets")
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    (request,) = [line for line in lines if line.get("event") == "request"]
    assert (request["method"], request["route"], request["status"]) == ("GET", "/v1/targets", 200)
    secret = api.client.headers["authorization"].rpartition("_")[2]
    assert secret not in json.dumps(lines)


@pytest.mark.usefixtures("restored_logging")
def test_a_pool_that_is_disposed_of_writes_no_line(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging("info")
    pool = LendingPool(lambda: sqlite3.connect(":memory:"))
    pool.dispose()
    pool.recreate()
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("restored_logging")
def test_a_defect_is_logged_without_the_secrets_around_it(
    open_api: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_api() as running:
        configure_logging("info")
        running.client.headers["X-Secret"] = "hush"
        # The originals' folder is gone: a defect no request could cause; the answer reveals nothing of it.
        shutil.rmtree(running.installation.blobs.root)
        response = running.client.get("/metrics")
        assert (response.status_code, response.json()["code"]) == (500, "internal_error")
        assert str(running.installation.settings.data_dir) not in response.text
    logged = capsys.readouterr().err
    (line,) = [line for line in logged.splitlines() if '"request_failed"' in line]
    assert json.loads(line)["exception"][0]["exc_type"] == "FileNotFoundError"
    assert json.loads(line)["request_id"] == response.headers["x-request-id"]
    assert "hush" not in logged


def test_secrets_lie_where_only_the_owner_reads(api: Any) -> None:
    pepper = api.installation.settings.data_dir / "key-pepper"
    assert pepper.stat().st_mode & 0o077 == 0
    assert len(pepper.read_bytes()) == 64


def test_what_may_be_read_may_be_asked_about(api: Any, grey_png: bytes) -> None:
    session_id = api.make_session()
    measurement_id = api.put_image(session_id, grey_png).json()["id"]
    image = f"/v1/measurements/{measurement_id}/image"
    for address in ("/livez", "/readyz", "/v1/targets", image, "/openapi.json", "/docs", "/v1/nothing"):
        asked, read = api.client.head(address), api.client.get(address)
        assert asked.content == b""
        for part in ("content-length", "content-type"):
            assert asked.headers[part] == read.headers[part]
        assert asked.status_code == read.status_code
    assert api.client.head("/v1/targets", headers={"Authorization": ""}).status_code == 401
    # An event stream never ends: nothing could be said of it by reading it.
    assert api.client.head(f"/v1/sessions/{session_id}/events").status_code == 405


def test_a_damaged_database_is_said_to_be_that(tmp_path: Path) -> None:
    (tmp_path / "damaged.sqlite3").write_bytes(b"no database at all " * 1000)
    database = Database(f"sqlite:///{tmp_path / 'damaged.sqlite3'}")
    with pytest.raises(Unavailable) as caught, database.read() as records:
        records.execute(sa.text("SELECT 1 FROM sessions"))
    assert caught.value.code == "database_damaged"
    database.dispose()


@pytest.mark.postgres
def test_a_postgresql_server_gone_without_a_word_is_noticed(postgres_url: str) -> None:
    def options(url: str) -> dict[str, str]:
        database = Database(url)
        with database.read() as records:
            driver = records.connection().connection.driver_connection
            found: dict[str, str] = driver.info.get_parameters()
        database.dispose()
        return found

    expected = {
        "connect_timeout": "10",
        "tcp_user_timeout": "20000",
        "keepalives": "1",
        "keepalives_idle": "10",
        "keepalives_interval": "5",
        "keepalives_count": "3",
    }
    assert expected.items() <= options(postgres_url).items()
    expected |= {"connect_timeout": "4", "keepalives_idle": "60"}
    assert expected.items() <= options(f"{postgres_url}?connect_timeout=4&keepalives_idle=60").items()


@pytest.mark.slow
def test_a_postgresql_server_that_never_answers_is_not_waited_for() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        database = Database(f"postgresql+psycopg://u@127.0.0.1:{silent.getsockname()[1]}/d?connect_timeout=2")
        with pytest.raises(Unavailable), database.read() as records:
            records.execute(sa.select(1))
        database.dispose()
