"""The running service against its own /openapi.json, attacked by schemathesis."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import httpx2
import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient


@pytest.mark.parametrize(
    ("examples", "phases"),
    [
        # Its own examples and every bound; what chance finds is for the long one.
        pytest.param(1, "examples,coverage", id="short"),
        pytest.param(400, "examples,coverage,fuzzing,stateful", id="long", marks=pytest.mark.soak),
    ],
)
def test_no_request_gets_an_answer_outside_the_contract(
    service: ServiceProcess, tmp_path: Path, examples: int, phases: str
) -> None:
    command = [
        *(sys.executable, "-c", "from schemathesis.cli import schemathesis; schemathesis()", "run"),
        f"{service.url}/openapi.json",
        *("--header", f"Authorization: Bearer {service.admin_key}"),
        *("--phases", phases, "--max-examples", str(examples), "--seed", "9283"),
        *("--exclude-path-regex", "/events$"),  # a stream has no end to check
        # Ids are those of earlier answers: with these two it would lock itself out.
        *("--exclude-operation-id", "revoke_key", "--exclude-operation-id", "update_key"),
        *("--checks", "all", "--exclude-checks", "positive_data_acceptance"),
        *("--continue-on-failure", "--no-shrink", "--request-timeout", "30", "--warnings", "off"),
        *("--suppress-health-check", "all"),
    ]
    ended = subprocess.run(
        command,
        cwd=tmp_path,
        env={**os.environ, "PYTHONWARNINGS": "default", "COLUMNS": "150"},
        capture_output=True,
        text=True,
        timeout=3600,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout[-20000:] + ended.stderr[-2000:]
    assert httpx2.get(f"{service.url}/readyz").status_code == 200
    with ServiceClient(service.url, service.admin_key) as client:
        client.get("/v1/sessions")


def test_writing_the_contract_touches_nothing_else(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "GRIDPOSE_DATA_DIR": str(tmp_path / "data"),
        "GRIDPOSE_AUTH": "off",
        "HOME": str(tmp_path),
    }
    subprocess.run(
        [sys.executable, "-m", "app.cli.openapi", "--check"],
        cwd=tmp_path,
        env=environment,
        check=True,
        timeout=60,
    )
    assert not list(tmp_path.iterdir())
