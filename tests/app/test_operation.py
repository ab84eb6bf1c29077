"""Health, metrics, documentation, headers, logs."""

from __future__ import annotations

import json
import logging
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
import structlog

import app
from app.errors import Unavailable
from app.logs import configure_logging
from app.main import AlreadyServed
from app.records.database import Database


def test_the_service_says_that_it_lives_and_is_ready(any_api: Any) -> None:
    assert any_api.client.get("/livez").json() == {"status": "ok"}
    ready = any_api.client.get("/readyz")
    assert ready.status_code == 200
    document = ready.json()
    assert [check["name"] for check in document["checks"]] == ["database", "migrations", "disk", "runner"]
    assert all(check["ok"] for check in document["checks"])
    assert "GRIDPOSE_WORKERS=0" in document["checks"][3]["detail"]


def test_a_stopped_runner_is_not_ready(open_api: Any) -> None:
    with open_api(workers=1) as running:
        assert running.client.get("/readyz").status_code == 200
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


def test_metrics_count_requests_by_route_and_measurements_by_status(api: Any, grey_png: bytes) -> None:
    api.put_image(api.make_session(), grey_png)
    api.client.get("/v1/sessions/none")
    response = api.client.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain")
    assert 'gridpose_measurements{status="queued"} 1.0' in response.text
    assert 'route="/v1/sessions/{session_id}",status="404"} 1.0' in response.text
    assert "none" not in response.text
    assert "gridpose_disk_free_bytes" in response.text


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


@pytest.fixture
def restored_logging() -> Iterator[None]:
    """Put logging back as it was: its configuration is the process's, not the test's."""
    root = logging.getLogger()
    handlers, level, ours = root.handlers[:], root.level, structlog.get_config()
    yield
    root.handlers[:], root.level = handlers, level
    structlog.configure(**ours)


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
def test_a_defect_is_logged_without_the_secrets_around_it(
    open_api: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_api() as running:
        configure_logging("info")
        running.client.headers["X-Secret"] = "hush"
        # The originals' folder is gone: a defect no request could cause, and none may be told of.
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
