"""The clock steps both ways while images are computed: no time limit fires, no result changes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.image.images import slow_image
from tests.support.service.service import new_session, wait_until
from tests.system.faults.images import BOARD
from tests.system.faults.injections import Clock
from tests.system.faults.supervisor import Supervisor
from tests.system.faults.trial import Trial

pytestmark = pytest.mark.soak


def test_clock_steps(trial: Trial, tmp_path: Path, need: Callable[[str], None]) -> None:
    need("cc")
    clock = Clock(tmp_path)
    with trial.serving(Supervisor(tmp_path / "data", clock.environment)) as service:
        data = slow_image()
        with trial.client() as client:
            session_id = new_session(client, BOARD)
            slow = client.put_image(session_id, "slow", hashlib.sha256(data).hexdigest(), data)["id"]

            def status() -> str:
                found: str = client.get(f"/v1/measurements/{slow}")["status"]
                return found

            wait_until(lambda: status() != "queued", 120, "the slow image is being computed")
            for step in (90, -3600, 86400):
                trial.inject()
                clock.step(step)
            wait_until(lambda: status() in ("succeeded", "failed"), 120, "the slow image is done")
            found = client.get(f"/v1/measurements/{slow}")
            assert found["failure"]["code"] == "target_not_found"
            assert found["attempts"] == 1
        uploads = trial.upload(60)
        for acknowledged, step in ((5, -86400), (15, 90), (30, 10 * 365 * 86400), (45, 0)):
            uploads.wait_for(acknowledged)
            trial.inject()
            clock.step(step)
        trial.conclude()
        assert service.starts == 1
