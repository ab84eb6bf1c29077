"""Write the backup of a small installation of the release that runs this, with what it answers, as one file.

    git worktree add ../release v0.1.0 && cd ../release
    PYTHONPATH=. python PATH/OF/tests/reference/releases/make.py 0.1.0

Only what every release has is imported: its application, its backup, and the clients of its tests.
"""

from __future__ import annotations

import gzip
import json
import math
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from starlette.testclient import TestClient

from app.main import create_app
from app.services.backup import make_backup
from app.settings import Settings
from core.simulation.renderer import render_levels
from core.targets.specification import TargetSpec
from tests.support.jobs.runners import compute
from tests.support.service.service import Api
from tests.support.simulation.scenes import standard_scene

POSES, CYCLES = 2, 3
BOARD = TargetSpec("chessboard", 9, 6, 25.0)
ROBOT = {
    "name": "arm",
    "joints": [{"a_mm": 0.0, "alpha_deg": 90.0, "d_mm": 400.0, "theta_offset_deg": 0.0}] * 6,
}


def make(version: str) -> Path:
    """Return the file just written."""
    path = Path(__file__).parent / f"{version}.tar.gz"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        app = create_app(Settings(data_dir=folder / "data", workers=0, disk_floor_bytes=0))
        with TestClient(app, base_url="http://localhost") as client:
            api = Api(client, app.state.service)
            client.headers.update(api.key("admin"))
            session = _session(api)
            answers = _answers(api, session)
            make_backup(api.installation, folder / "backup")
        (folder / "backup" / "answers.json").write_text(json.dumps(answers, indent=1), encoding="utf-8")
        with gzip.GzipFile(path, "wb", 9, mtime=0) as stream, tarfile.open(fileobj=stream, mode="w") as tar:
            tar.add(folder / "backup", ".", filter=_plain)
    return path


def _session(api: Api) -> str:
    robot = api.client.post("/v1/robots", json=ROBOT).json()["id"]
    session = api.make_session(name="Cell 4 ä", robot_id=robot, conditions={"load_kg": 5.0})
    for pose in range(1, POSES + 1):
        scene = standard_scene(BOARD, seed=pose, tilt=math.radians(25.0 + 5.0 * pose), clutter=0.0)
        levels = cv2.resize(render_levels(scene), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        for cycle in range(1, CYCLES + 1):
            moved = np.roll(levels, cycle - 2, axis=1)  # a pixel to either side: cycles of a scatter
            pixels = np.clip(np.rint(moved), 0, 255).astype(np.uint8)
            done, image = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])
            assert done
            assert api.put_image(session, image.tobytes(), f"P{pose}", cycle=cycle).status_code == 202
    compute(api)
    return session


def _answers(api: Api, session: str) -> dict[str, Any]:
    found = [one["id"] for one in api.measurements(session)]
    table = api.client.get(f"/v1/sessions/{session}/repeatability")
    assert table.status_code == 200, table.text
    return {
        "session_id": session,
        "authorization": api.client.headers["Authorization"],
        "measurements": {one: api.measurement(one, include="points") for one in found},
        "repeatability": table.json(),
    }


def _plain(member: tarfile.TarInfo) -> tarfile.TarInfo:
    member.uid = member.gid = 0
    member.uname = member.gname = ""
    member.mtime = 0
    return member


if __name__ == "__main__":
    print(make(sys.argv[1]))
