"""Images that show two grids and name neither, on a service that is killed again and again: each measured once."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter
from collections.abc import Callable

from app.cli.demo.service_process import ServiceProcess
from app.client import ServiceClient
from core import TargetSpec
from tests.support.service.service import wait_until
from tests.support.simulation.room_corner import Corner

SPECS = (TargetSpec("chessboard", 8, 5, 18.0), TargetSpec("charuco", 6, 5, 22.0, 16.0, "DICT_5X5_100"))
IMAGES = 12


def test_every_grid_is_measured_once_whatever_is_killed(make_service: Callable[..., ServiceProcess]) -> None:
    corner = Corner(*SPECS)
    image = corner.image(corner.view(turn=0.2))
    images = [image + b"%d" % number for number in range(IMAGES)]  # what follows a PNG's end is not looked at
    service = make_service().start()
    key = service.admin_key
    with ServiceClient(service.url, key) as client:
        targets = [
            client.create("/v1/targets", {"name": spec.kind, **dataclasses.asdict(spec)})["id"]
            for spec in SPECS
        ]
        session_id = client.create("/v1/sessions", {"name": "s", "target_ids": targets})["id"]
        for number, data in enumerate(images):
            client.put_image(session_id, f"P{number % 3}", hashlib.sha256(data).hexdigest(), data)

    def finished() -> int:
        with ServiceClient(service.url, key) as client:
            counts = client.get(f"/v1/sessions/{session_id}")["counts"]
        return int(counts["succeeded"] + counts["failed"])

    for measurements in (IMAGES // 2, IMAGES):  # a quarter and a half of all: there is work under way
        wait_until(lambda least=measurements: finished() >= least, 120.0, "some images are measured")
        service.kill()
        service = make_service().start()
    wait_until(lambda: finished() == 2 * IMAGES, 120.0, "all images are measured")
    with ServiceClient(service.url, key) as client:
        found = list(client.items(f"/v1/sessions/{session_id}/measurements"))
    assert {m["status"] for m in found} == {"succeeded"}
    shown = Counter((m["pose_id"], m["sha256"], m["target_id"]) for m in found)
    assert set(shown.values()) == {1}
    assert Counter(m["target_id"] for m in found) == dict.fromkeys(targets, IMAGES)
    by_id = {m["id"]: m for m in found}
    for m in found:
        (sibling,) = (by_id[other] for other in m["siblings"])
        assert sibling["siblings"] == [m["id"]]
        assert (sibling["pose_id"], sibling["sha256"]) == (m["pose_id"], m["sha256"])
