"""One trial: a service, clients with a journal, a fault, and the account of what came of every upload."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.client import ServiceClient
from tests.support.service.service import new_session
from tests.support.service.uploads import Uploaders, finished_measurements
from tests.system.faults.images import BOARD, KINDS, Form, image
from tests.system.faults.supervisor import Supervisor

ENDURED = frozenset({429, 503, 507})
"""Answers that ask the client to come again: the service may refuse under a fault, but says so properly."""
_POSE_EVERY = 10
_COMPARED = ("status", "failure", "calibration", "capture_quality", "points")

Results = dict[int, dict[str, Any]]
"""What came of each kind of image: its compared fields."""


@dataclass
class Account:
    """One row of the table."""

    fault: str
    injected: int = 0
    survived: int = 0
    acknowledged: int = 0
    lost: int = 0
    doubled: int = 0
    changed: int = 0
    restarts: int = 0
    seconds: float = 0.0


class Trial:
    """Uploads to one service, and their account at the end.

    `reference` is what the images amount to in an undisturbed run.
    """

    def __init__(self, account: Account, reference: Results) -> None:
        self.account = account
        self._reference = reference
        self._kinds: dict[str, int] = {}
        self._uploaders: list[tuple[str, Uploaders]] = []
        self._service: Supervisor | None = None

    @property
    def service(self) -> Supervisor:
        assert self._service is not None
        return self._service

    @contextmanager
    def serving(self, service: Supervisor) -> Iterator[Supervisor]:
        """Run the service for the length of the trial."""
        self._service = service
        started = time.monotonic()
        try:
            with service:
                yield service
        finally:
            self.account.restarts = max(0, service.starts - 1)
            self.account.seconds = time.monotonic() - started

    def client(self) -> ServiceClient:
        return ServiceClient(self.service.url, self.service.admin_key)

    def new_session(self) -> str:
        """Make a session for uploads, and return its id."""
        with self.client() as client:
            return new_session(client, BOARD)

    def upload(
        self,
        count: int,
        first: int = 0,
        form: Form = "png",
        *,
        session_id: str | None = None,
        held_from: int | None = None,
    ) -> Uploaders:
        """Begin to upload images `first` to `first + count` to a session: to one of their own unless one is named."""
        service = self.service
        assert service.admin_key is not None
        session_id = session_id or self.new_session()

        def make(number: int) -> tuple[str, bytes]:
            data = image(first + number, form)
            self._kinds[hashlib.sha256(data).hexdigest()] = (first + number) % KINDS
            return f"P{number // _POSE_EVERY}", data

        uploaders = Uploaders(
            session_id,
            service.admin_key,
            make,
            count,
            lambda: service.url,
            endured=ENDURED,
            held_from=held_from,
        )
        self._uploaders.append((session_id, uploaders))
        uploaders.begin()
        return uploaders

    def inject(self, faults: int = 1) -> None:
        """Note that a fault was brought about."""
        self.account.injected += faults

    def conclude(self, *, excused: frozenset[str] = frozenset()) -> None:
        """Check what must hold after every fault.

        The service is ready; each acknowledged upload is there once, with its bytes; each came to an end; each
        result is the reference's. An image that failed with an `excused` code is computed again first: those are
        failures that the fault itself causes.
        """
        self.service.until_ready()
        for session_id, uploaders in self._uploaders:
            uploaders.finish()
            self._check_session(session_id, uploaders.acknowledged, excused)
        account = self.account
        assert (account.lost, account.doubled, account.changed) == (0, 0, 0), account
        account.survived = account.injected

    def _check_session(
        self, session_id: str, acknowledged: list[tuple[str, str]], excused: frozenset[str]
    ) -> None:
        with self.client() as client:
            found = finished_measurements(client, session_id)
            again = [m for m in found if m["status"] == "failed" and m["failure"]["code"] in excused]
            for m in again:
                client.create(f"/v1/measurements/{m['id']}/retry", {})
            if again:
                found = finished_measurements(client, session_id)
            rows = Counter((m["pose_id"], m["sha256"]) for m in found)
            self.account.acknowledged += len(acknowledged)
            self.account.lost += sum(1 for upload in acknowledged if rows[upload] == 0)
            self.account.doubled += sum(1 for count in rows.values() if count > 1)
            for m in found:
                original = client.get_bytes(f"/v1/measurements/{m['id']}/image")
                self.account.lost += hashlib.sha256(original).hexdigest() != m["sha256"]
                whole = client.get(f"/v1/measurements/{m['id']}", include="points")
                self.account.changed += compared(whole) != self._reference[self._kinds[m["sha256"]]]


def compared(measurement: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a measurement that only the image and the build decide."""
    return {field: measurement[field] for field in _COMPARED}


def undisturbed(data_dir: Path) -> Results:
    """Return what each kind of image amounts to when nothing happens."""
    trial = Trial(Account("none"), {})
    with trial.serving(Supervisor(data_dir)):
        uploaders = trial.upload(KINDS)
        uploaders.finish()
        (session_id,) = [session for session, _ in trial._uploaders]
        with trial.client() as client:
            return {
                trial._kinds[m["sha256"]]: compared(
                    client.get(f"/v1/measurements/{m['id']}", include="points")
                )
                for m in finished_measurements(client, session_id)
            }
