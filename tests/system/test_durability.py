"""202 means that file and row are on disk: acknowledged uploads survive kill -9, each exactly once."""

from __future__ import annotations

import hashlib
import random
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest

from app.agent import ServiceClient
from app.cli.process import ServiceProcess

UPLOADERS = 2


class Shift:
    """Uploaders that send images as fast as they are acknowledged, whatever happens to the service meanwhile."""

    def __init__(self, session_path: str, key: str, uploads: int, image: Callable[[int], bytes]) -> None:
        self.acknowledged: list[tuple[str, str]] = []
        self.failures: list[str] = []
        self._session_path = session_path
        self._headers = {"Authorization": f"Bearer {key}", "Content-Type": "application/octet-stream"}
        self._image = image
        self._url = ""
        self._news = threading.Condition()
        self._numbers = iter(range(uploads))
        self._threads = [threading.Thread(target=self._upload, daemon=True) for _ in range(UPLOADERS)]

    def serve_at(self, url: str) -> None:
        """Tell the uploaders where the service is now; the first time they begin."""
        with self._news:
            started, self._url = bool(self._url), url
            self._news.notify_all()
        if not started:
            for thread in self._threads:
                thread.start()

    def wait_for(self, acknowledged: int) -> None:
        with self._news:
            enough = self._news.wait_for(
                lambda: len(self.acknowledged) >= acknowledged or bool(self.failures), timeout=120
            )
        assert not self.failures, self.failures
        assert enough, f"only {len(self.acknowledged)} uploads were acknowledged"

    def finish(self) -> None:
        for thread in self._threads:
            thread.join(120)
            assert not thread.is_alive(), "an uploader never ended"
        assert not self.failures, self.failures

    def _upload(self) -> None:
        with httpx2.Client(headers=self._headers, timeout=30) as http:
            while True:
                with self._news:
                    number = next(self._numbers, None)
                if number is None:
                    return
                data = self._image(number)
                sha256, pose_id = hashlib.sha256(data).hexdigest(), f"P{number % 7}"
                path = f"{self._session_path}/poses/{pose_id}/images/{sha256}"
                if not self._send_until_answered(http, path, data):
                    return
                with self._news:
                    self.acknowledged.append((pose_id, sha256))
                    self._news.notify_all()

    def _send_until_answered(self, http: httpx2.Client, path: str, data: bytes) -> bool:
        while True:
            url = self._url
            try:
                response = http.put(url + path, content=data)
            except httpx2.TransportError:
                with self._news:  # killed: wait until told where it runs again
                    if not self._news.wait_for(lambda url=url: self._url != url, timeout=120):
                        self.failures.append("the service did not come back")
                        return False
                continue
            if response.status_code not in (200, 202):
                with self._news:
                    self.failures.append(f"{response.status_code} {response.text}")
                    self._news.notify_all()
                return False
            return True


@pytest.mark.parametrize(
    ("kills", "uploads"),
    [
        pytest.param(4, 240, id="short"),
        pytest.param(24, 5200, id="long", marks=pytest.mark.soak),
    ],
)
def test_kill_9_loses_nothing_and_doubles_nothing(
    make_service: Callable[..., ServiceProcess], small_image: Callable[[int], bytes], kills: int, uploads: int
) -> None:
    service = make_service().start()
    key = service.admin_key
    assert key is not None
    session_id = new_session(service, key)
    shift = Shift(f"/v1/sessions/{session_id}", key, uploads, small_image)
    shift.serve_at(service.url)
    moments = random.Random(kills)
    for kill in range(kills):
        shift.wait_for((kill * uploads) // (kills + 1) + moments.randrange(1, uploads // (2 * kills + 2)))
        service.kill()
        service = make_service().start()
        shift.serve_at(service.url)
    shift.finish()
    assert len(shift.acknowledged) == uploads

    with ServiceClient(service.url, key) as client:
        found = finished_measurements(client, session_id, uploads)
        assert sorted((m["pose_id"], m["sha256"]) for m in found) == sorted(shift.acknowledged)
        # A restart never counts as an attempt, and every image came to an ordinary end.
        assert {(m["status"], m["failure"]["code"]) for m in found} == {("failed", "target_not_found")}
        for m in random.Random(1).sample(found, 25):
            original = client.get_bytes(f"/v1/measurements/{m['id']}/image")
            assert hashlib.sha256(original).hexdigest() == m["sha256"]
    originals = {p.name for p in Path(service.data_dir).rglob("*") if p.is_file() and len(p.stem) >= 60}
    assert len(originals) == uploads, "each original is kept once"


def new_session(service: ServiceProcess, key: str) -> str:
    target = {"name": "board", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}
    with ServiceClient(service.url, key) as client:
        target_id = client.create("/v1/targets", target)["id"]
        session_id: str = client.create("/v1/sessions", {"name": "shift", "target_ids": [target_id]})["id"]
    return session_id


def finished_measurements(client: ServiceClient, session_id: str, expected: int) -> list[dict[str, Any]]:
    """Wait until nothing is queued or running, as long as things move, and return all measurements."""
    stuck = 0
    last = None
    while stuck < 600:
        counts = client.get(f"/v1/sessions/{session_id}")["counts"]
        if not counts["queued"] and not counts["running"]:
            break
        stuck = stuck + 1 if counts == last else 0
        last = counts
        threading.Event().wait(0.1)
    assert not counts["queued"], counts
    assert not counts["running"], counts
    found = list(client.items(f"/v1/sessions/{session_id}/measurements"))
    assert len(found) == expected
    return found
