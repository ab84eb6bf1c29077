"""What tests of the service share: clients of a running application, and its command line."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from app.api.dependencies import AppContext
from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from app.records.database import Database
from app.records.tables import AccessVersion, Measurement
from app.services.installation.context import ServiceContext
from app.services.keys import create_key

TARGET = {"name": "board", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
OCTETS = {"Content-Type": "application/octet-stream"}
POLL_S, REQUEST_EVERY_S = 0.02, 0.2
"""A request costs several ms of processor time: more of them slow down what is waited for."""
_LEAKS = re.compile(
    r"Traceback|pydantic|sqlalchemy|sqlite|psycopg|File \"|/tmp/|Input should|Error\b", re.IGNORECASE
)


@dataclass(frozen=True)
class Api:
    """A client of one running application, with an admin key."""

    client: Any
    service: AppContext

    @property
    def installation(self) -> ServiceContext:
        return self.service.installation

    def make_target(self, **changes: Any) -> str:
        response = self.client.post("/v1/targets", json={**TARGET, **changes})
        assert response.status_code == 201, response.text
        return str(response.json()["id"])

    def make_robot(self, name: str = "arm") -> str:
        """Make a robot of one joint."""
        joint = {"a_mm": 100.0, "alpha_deg": 0.0, "d_mm": 0.0}
        return str(self.client.post("/v1/robots", json={"name": name, "joints": [joint]}).json()["id"])

    def make_session(self, *target_ids: str, **fields: Any) -> str:
        ids = list(target_ids) or [self.make_target()]
        response = self.client.post("/v1/sessions", json={"name": "session", "target_ids": ids, **fields})
        assert response.status_code == 201, response.text
        return str(response.json()["id"])

    def put_image(self, session_id: str, data: bytes, pose_id: str = "P1", **query: Any) -> Any:
        address = image_address(session_id, data, pose_id)
        return self.client.put(address, content=data, params=query, headers=OCTETS)

    def measurement(self, measurement_id: str, **query: Any) -> dict[str, Any]:
        """Return a measurement's document."""
        response = self.client.get(f"/v1/measurements/{measurement_id}", params=query)
        assert response.status_code == 200, response.text
        document: dict[str, Any] = response.json()
        return document

    def measurements(self, session_id: str) -> list[dict[str, Any]]:
        """Return the first page of a session's measurements."""
        response = self.client.get(f"/v1/sessions/{session_id}/measurements")
        assert response.status_code == 200, response.text
        items: list[dict[str, Any]] = response.json()["items"]
        return items

    def key(self, scope: str, **limits: Any) -> dict[str, str]:
        """Headers that hold a new key with this scope."""
        return {"Authorization": f"Bearer {create_key(self.installation, scope, scope, **limits).secret_key}"}

    def wait_for(self, measurement_id: str, within_s: float = 300.0) -> dict[str, Any]:
        """Return a measurement once it is finished."""
        wait_until(lambda: self._is_finished(measurement_id), within_s, "the measurement is finished")
        return self.measurement(measurement_id)

    def _is_finished(self, measurement_id: str) -> bool:
        """Ask the database, which costs a twentieth of a request."""
        with self.installation.database.read() as records:
            status = records.scalar(sa.select(Measurement.status).where(Measurement.id == measurement_id))
        return status in ("succeeded", "failed")


def access_version(database: Database) -> int:
    """Return the version of keys and sessions as the database has it now."""
    with database.read() as records:
        return records.scalar(sa.select(AccessVersion.version)) or 0


ApiMaker = Callable[..., AbstractContextManager[Api]]


def image_address(session_id: str, data: bytes, pose_id: str = "P1") -> str:
    """Return the path that an image of a pose is sent to."""
    return f"/v1/sessions/{session_id}/poses/{pose_id}/images/{hashlib.sha256(data).hexdigest()}"


def assert_problem(response: Any, status: int, code: str | None = None) -> dict[str, Any]:
    """Check a problem document whole and return it."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    problem: dict[str, Any] = response.json()
    assert set(problem) == {"type", "title", "status", "detail", "code", "advice", "errors"}
    assert problem["status"] == status
    assert re.fullmatch(r"[a-z][a-z0-9_]*", problem["code"])
    assert problem["type"] == f"urn:gridpose:problem:{problem['code']}"
    assert all(set(error) == {"field", "message"} for error in problem["errors"])
    assert not _LEAKS.search(response.text), response.text
    if code is not None:
        assert problem["code"] == code
    return problem


def wait_until(condition: Callable[[], bool], within_s: float = 300.0, what: str = "the condition") -> None:
    """Return once a condition holds; fail with its name when it does not in time.

    The longer a condition takes, as a request to a service does, the less often it is looked at.
    """
    deadline = time.monotonic() + within_s
    while True:
        began = time.monotonic()
        if condition():
            return
        now = time.monotonic()
        assert now < deadline, f"not within {within_s:g} s: {what}"
        time.sleep(min(max(POLL_S, 8.0 * (now - began)), REQUEST_EVERY_S))


def new_session(client: ServiceClient, target: dict[str, Any] = TARGET, **fields: Any) -> str:
    """Make a target and a session with it; return the session's id."""
    target_id = client.create("/v1/targets", target)["id"]
    session = client.create("/v1/sessions", {"name": "shift", "target_ids": [target_id], **fields})
    return str(session["id"])


def put(client: ServiceClient, session_id: str, data: bytes, pose_id: str = "P1") -> str:
    """Send an image and return its measurement's id."""
    sha256 = hashlib.sha256(data).hexdigest()
    return str(client.put_image(session_id, pose_id, sha256, data)["id"])


def run_at(service: ServiceProcess, *arguments: str) -> tuple[int, str, str]:
    """Run the command line against a service; return exit code, output and errors."""
    ended = gridpose(*arguments, GRIDPOSE_URL=service.url, GRIDPOSE_KEY=service.admin_key or "")
    return ended.returncode, ended.stdout.strip(), ended.stderr


def environment_of(api: Any) -> dict[str, str]:
    """Return what names a served application and its admin key to a command."""
    key = api.client.headers["authorization"].removeprefix("Bearer ")
    return {"GRIDPOSE_URL": str(api.client.base_url), "GRIDPOSE_KEY": key}


def gridpose(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own; it ends, and never in a traceback."""
    ended = subprocess.run(
        [sys.executable, "-m", "app.cli", *arguments],
        env={**os.environ, "COLUMNS": "200", "NO_COLOR": "1", **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert "Traceback" not in ended.stdout + ended.stderr, ended.stderr
    return ended
