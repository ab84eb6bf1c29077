"""Clients that send images whatever happens to the service, and keep a journal of what was acknowledged."""

from __future__ import annotations

import hashlib
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import httpx2

from app.client import ServiceClient
from tests.support.service.service import REQUEST_EVERY_S

UPLOADERS = 2
WITHIN_S = 240.0
"""How long one upload may wait for the service to come back, and a test for the uploaders."""
_PAUSE_S = 0.05


class Uploaders:
    """Two clients that send upload 0, 1, ... of `uploads` until each one is acknowledged.

    `uploads` gives the pose and the bytes of an upload by its number; `where` gives the service's present address,
    an empty text while it has none. A broken connection is tried again, and so is an answer whose status is in
    `endured`; any other refusal ends the uploaders and fails the test. Upload `held_from` and later ones wait for
    `release`, so that a test's fault comes before them on a machine of any speed.
    """

    def __init__(
        self,
        session_id: str,
        key: str,
        uploads: Callable[[int], tuple[str, bytes]],
        count: int,
        where: Callable[[], str],
        *,
        endured: frozenset[int] = frozenset(),
        held_from: int | None = None,
    ) -> None:
        self.acknowledged: list[tuple[str, str]] = []
        self.refusals: Counter[str] = Counter()
        self.failures: list[str] = []
        self._session_path = f"/v1/sessions/{session_id}"
        self._headers = {"Authorization": f"Bearer {key}", "Content-Type": "application/octet-stream"}
        self._uploads = uploads
        self._count = count
        self._where = where
        self._endured = endured
        self._released = count if held_from is None else held_from
        self._news = threading.Condition()
        self._pause = threading.Event()
        self._begun = 0
        self._threads = [threading.Thread(target=self._upload_all, daemon=True) for _ in range(UPLOADERS)]

    def begin(self) -> None:
        for thread in self._threads:
            thread.start()

    def wait_for(self, acknowledged: int) -> None:
        """Wait until so many uploads are acknowledged."""
        self.wait_until(lambda: len(self.acknowledged) >= acknowledged)

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait until `condition` holds, which is asked after every answer."""
        with self._news:
            met = self._news.wait_for(lambda: condition() or bool(self.failures), timeout=WITHIN_S)
        assert not self.failures, self.failures
        assert met, f"{len(self.acknowledged)} uploads were acknowledged; refused: {dict(self.refusals)}"

    def release(self, count: int) -> None:
        """Let uploads before number `count` begin."""
        with self._news:
            self._released = count
            self._news.notify_all()

    def stop_early(self) -> None:
        """Begin no further upload; those under way are sent until acknowledged."""
        with self._news:
            self._count = self._begun
            self._news.notify_all()

    def finish(self) -> None:
        """Wait until every upload that was begun is acknowledged."""
        for thread in self._threads:
            thread.join(WITHIN_S)
            assert not thread.is_alive(), f"an uploader never ended; refused: {dict(self.refusals)}"
        assert not self.failures, self.failures

    def _upload_all(self) -> None:
        with httpx2.Client(headers=self._headers, timeout=30) as http:
            while True:
                number = self._next_number()
                if number is None:
                    return
                pose_id, data = self._uploads(number)
                sha256 = hashlib.sha256(data).hexdigest()
                failure = self._send_until_acknowledged(http, pose_id, sha256, data)
                with self._news:
                    if failure is None:
                        self.acknowledged.append((pose_id, sha256))
                    else:
                        self.failures.append(failure)
                    self._news.notify_all()
                if failure is not None:
                    return

    def _next_number(self) -> int | None:
        with self._news:
            self._news.wait_for(lambda: self._begun >= self._count or self._begun < self._released)
            if self._begun >= self._count:
                return None
            self._begun += 1
            self._news.notify_all()
            return self._begun - 1

    def _send_until_acknowledged(
        self, http: httpx2.Client, pose_id: str, sha256: str, data: bytes
    ) -> str | None:
        """Return None once the image is acknowledged, else why it never was."""
        deadline = time.monotonic() + WITHIN_S
        last = "there was no service"
        while time.monotonic() < deadline:
            if url := self._where():
                try:
                    response = http.put(
                        f"{url}{self._session_path}/poses/{pose_id}/images/{sha256}", content=data
                    )
                except httpx2.TransportError as error:
                    last = type(error).__name__
                else:
                    if response.status_code in (200, 202):
                        return None
                    last = f"{response.status_code} {response.text}"
                    if response.status_code not in self._endured:
                        return last
                with self._news:
                    self.refusals[last.split(maxsplit=1)[0]] += 1
                    self._news.notify_all()
            self._pause.wait(_PAUSE_S)
        return f"not acknowledged within {WITHIN_S:g} s; last: {last}"


def finished_measurements(client: ServiceClient, session_id: str) -> list[dict[str, Any]]:
    """Wait until nothing is queued or running, as long as things move, and return all measurements."""
    stuck = 0
    last = None
    while stuck < 600:
        counts = client.get(f"/v1/sessions/{session_id}")["counts"]
        if not counts["queued"] and not counts["running"]:
            break
        stuck = stuck + 1 if counts == last else 0
        last = counts
        time.sleep(REQUEST_EVERY_S)
    assert not counts["queued"], counts
    assert not counts["running"], counts
    return list(client.items(f"/v1/sessions/{session_id}/measurements"))
