"""Requests that must succeed, and waiting for what they order."""

from __future__ import annotations

import time
from typing import Any

TIMEOUT_S = 300.0
CSV = {"Accept": "text/csv"}


def report_made(client: Any, report: dict[str, Any]) -> str:
    """Return a report's path once it is made."""
    path = f"/v1/reports/{report['id']}"
    deadline = time.monotonic() + TIMEOUT_S
    while (found := client.get(path).json())["status"] in ("queued", "running"):
        assert time.monotonic() < deadline, "the report is not made"
        time.sleep(0.1)
    assert found["status"] == "succeeded", found["failure"]
    return path


def listed(client: Any, path: str) -> list[Any]:
    """Ask for a list as JSON, and for its beginning as a table."""
    return [client.get(path), client.get(path, params={"limit": 2}, headers=CSV)]


def create(client: Any, path: str, body: dict[str, Any]) -> str:
    return str(done(client.post(path, json=body)).json()["id"])


def wait(client: Any, session_id: str) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while True:
        counts = done(client.get(f"/v1/sessions/{session_id}")).json()["counts"]
        if counts["queued"] + counts["running"] == 0:
            assert counts["succeeded"] > 0, counts
            return
        assert time.monotonic() < deadline, counts
        time.sleep(0.1)


def done(*responses: Any) -> Any:
    """Return the last response; each must be a success."""
    for response in responses:
        assert response.is_success, f"{response.request.url}: {response.text[:500]}"
    return responses[-1]
