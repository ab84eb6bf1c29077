"""Measure a session with the generated Python client: `measure.py URL KEY MANIFEST`."""

from __future__ import annotations

import json
import sys
import time
from io import BytesIO
from pathlib import Path

from gridpose_client import AuthenticatedClient
from gridpose_client.api.analyses import get_repeatability
from gridpose_client.api.measurements import put_image
from gridpose_client.api.sessions import create_session, get_session
from gridpose_client.api.targets import create_target
from gridpose_client.models import (
    MeasurementRead,
    RepeatabilityAnalysis,
    SessionCreate,
    SessionRead,
    TargetCreate,
    TargetRead,
)
from gridpose_client.types import File


def main(url: str, key: str, manifest_path: str) -> None:
    manifest = json.loads(Path(manifest_path).read_text(encoding="utf-8"))
    with AuthenticatedClient(url, key, timeout=60.0) as client:
        target = create_target.sync(client=client, body=TargetCreate.from_dict(manifest["target"]))
        assert isinstance(target, TargetRead), target
        session = create_session.sync(
            client=client, body=SessionCreate(name="Python", target_ids=[target.id])
        )
        assert isinstance(session, SessionRead), session
        for image in manifest["images"]:
            measurement = put_image.sync(
                session.id,
                image["pose_id"],
                image["sha256"],
                client=client,
                body=File(BytesIO(Path(image["path"]).read_bytes())),
                cycle=image["cycle"],
            )
            assert isinstance(measurement, MeasurementRead), measurement
        deadline = time.monotonic() + 60.0
        while True:
            found = get_session.sync(session.id, client=client)
            assert isinstance(found, SessionRead), found
            if found.counts.queued + found.counts.running == 0:
                break
            assert time.monotonic() < deadline, found.counts
            time.sleep(0.1)
        table = get_repeatability.sync(session.id, client=client)
        assert isinstance(table, RepeatabilityAnalysis), table
    (row,) = (row for row in table.poses if row.pose_id == "P1")
    rp_l_mm, true_mm = row.repeatability.rp_l_mm, manifest["rp_l_mm"]
    assert row.cycles == manifest["cycles"]
    assert abs(rp_l_mm - true_mm) <= manifest["tolerance"] * true_mm, (rp_l_mm, true_mm)
    print(f"          P1: RP_l {rp_l_mm:.3f} mm, truly {true_mm:.3f} mm, verdict {row.verdict}")


if __name__ == "__main__":
    main(*sys.argv[1:])
