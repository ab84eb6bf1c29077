"""The real service in short, in every run of the suite: an upload, its result, a kill, an orderly end."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import httpx2

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from tests.support.service.service import gridpose
from tests.system.faults.images import image

PROJECT = Path(__file__).parents[2]


def test_an_upload_is_measured_and_outlives_a_killed_service(tmp_path: Path) -> None:
    shown, empty = image(0), image(5)
    folder = tmp_path / "images"
    folder.mkdir()
    for name, data in (("P1-c1.png", shown), ("P2-c1.png", empty)):
        (folder / name).write_bytes(data)
    environment = {"GRIDPOSE_WORKERS": "1"}
    service = ServiceProcess(tmp_path / "data", environment)
    with service:
        key = service.admin_key or ""
        committed = json.loads((PROJECT / "openapi.json").read_text(encoding="utf-8"))
        assert httpx2.get(f"{service.url}/openapi.json", timeout=60.0).json() == committed
        options = ("--session", "cell", "--target", "chessboard:7x5:10", "--url", service.url, "--wait")
        uploaded = gridpose("upload", str(folder), *options, GRIDPOSE_KEY=key)
        assert uploaded.returncode == 1, "one of the two shows no target"
        assert gridpose("doctor", "--data-dir", str(service.data_dir)).returncode == 0
        before = measurements(service.url, key)
        assert {sha256: m["status"] for sha256, m in before.items()} == {
            hashlib.sha256(shown).hexdigest(): "succeeded",
            hashlib.sha256(empty).hexdigest(): "failed",
        }
        service.kill()
    with service:
        assert service.admin_key == key
        assert measurements(service.url, key) == before
        with ServiceClient(service.url, key) as client:
            for sha256, measurement in before.items():
                original = client.get_bytes(f"/v1/measurements/{measurement['id']}/image")
                assert hashlib.sha256(original).hexdigest() == sha256
        assert service.stop() == 0


def measurements(url: str, key: str) -> dict[str, dict[str, object]]:
    """Return all measurements of the one session by the hashes of their images."""
    with ServiceClient(url, key) as client:
        (session,) = client.items("/v1/sessions")
        return {m["sha256"]: m for m in client.items(f"/v1/sessions/{session['id']}/measurements")}
