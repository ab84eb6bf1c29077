"""202 means that file and row are on disk: acknowledged uploads survive kill -9, each exactly once."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Callable
from pathlib import Path

import pytest

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from tests.support.image.images import small_image
from tests.support.service.service import new_session
from tests.support.service.uploads import Uploaders, finished_measurements


@pytest.mark.parametrize(
    ("kills", "uploads"),
    [
        pytest.param(2, 110, id="short"),
        pytest.param(24, 5200, id="long", marks=pytest.mark.soak),
    ],
)
def test_kill_9_loses_nothing_and_doubles_nothing(
    make_service: Callable[..., ServiceProcess], kills: int, uploads: int
) -> None:
    service = make_service().start()
    key = service.admin_key
    assert key is not None
    with ServiceClient(service.url, key) as client:
        session_id = new_session(client)
    shift = Uploaders(
        session_id, key, lambda number: (f"P{number % 7}", small_image(number)), uploads, lambda: service.url
    )
    shift.begin()
    moments = random.Random(kills)
    for kill in range(kills):
        shift.wait_for((kill * uploads) // (kills + 1) + moments.randrange(1, uploads // (2 * kills + 2)))
        service.kill()
        service = make_service().start()
    shift.finish()
    assert len(shift.acknowledged) == uploads

    with ServiceClient(service.url, key) as client:
        found = finished_measurements(client, session_id)
        assert sorted((m["pose_id"], m["sha256"]) for m in found) == sorted(shift.acknowledged)
        # A restart never counts as an attempt, and every image came to an ordinary end.
        assert {(m["status"], m["failure"]["code"]) for m in found} == {("failed", "target_not_found")}
        for m in random.Random(1).sample(found, 25):
            original = client.get_bytes(f"/v1/measurements/{m['id']}/image")
            assert hashlib.sha256(original).hexdigest() == m["sha256"]
    originals = {p.name for p in Path(service.data_dir).rglob("*") if p.is_file() and len(p.stem) >= 60}
    assert len(originals) == uploads, "each original is kept once"
