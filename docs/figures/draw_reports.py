"""Draw the first page of a report of each kind, as the service makes it of simulated sessions (`make figures`)."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pypdfium2
from starlette.testclient import TestClient

sys.path.insert(0, str(Path(__file__).parents[2]))

from app.cli.demo.session import joint_rows
from app.main import create_app
from app.settings import Settings
from core.simulation import KR5_ARC
from tests.support.service.service import Api
from tests.support.sessions.kinematics import measured, readings
from tests.support.sessions.stored_sessions import BOARD, board_fields, shoot, store_shots

FOLDER = Path(__file__).parent
_SCALE = 1.1
_WITHIN_S = 600.0
_CONDITIONS = {
    "temperature_c": 21.5,
    "load_kg": 5.0,
    "speed_percent": 100.0,
    "warm_up_min": 60.0,
    "operator": "R. Meier",
}


def main() -> None:
    """Make the sessions and their reports in a folder of their own, and draw each first page."""
    with tempfile.TemporaryDirectory() as folder:
        app = create_app(Settings(data_dir=Path(folder) / "data", workers=0, disk_floor_bytes=0))
        with TestClient(app, base_url="http://localhost") as client:
            api = Api(client, app.state.service)
            client.headers.update(api.key("admin"))
            robot = {
                "name": "KR 5 arc, cell 4",
                "joints": joint_rows(KR5_ARC),
                "manufacturer": "KUKA",
                "model": "KR 5 arc",
                "serial_number": "412",
                "datasheet_repeatability_mm": 0.1,
            }
            robot_id = client.post("/v1/robots", json=robot).json()["id"]
            target_id = api.make_target(**board_fields(BOARD))
            cell = api.make_session(target_id, name="Cell 4", robot_id=robot_id, conditions=_CONDITIONS)
            store_shots(api, cell, shoot(poses=5, cycles=30), target_id)
            tracker = api.make_session(target_id, name="Laser tracker", robot_id=robot_id)
            poses = readings(measured()[1])
            assert client.post(f"/v1/sessions/{tracker}/measured-poses", json=poses).is_success
            for kind, session_id in (
                ("repeatability", cell),
                ("kinematics", tracker),
                ("camera", cell),
                ("session", cell),
            ):
                _draw(client, kind, session_id)


def _draw(client: Any, kind: str, session_id: str) -> None:
    signatories = [{"name": "R. Meier", "role": "operator"}]
    body = {"kind": kind, "signatories": signatories}
    report = f"/v1/reports/{client.post(f'/v1/sessions/{session_id}/reports', json=body).json()['id']}"
    deadline = time.monotonic() + _WITHIN_S
    while (found := client.get(report).json())["status"] in ("queued", "running"):
        assert time.monotonic() < deadline, "the report is not made"
        time.sleep(0.5)
    assert found["status"] == "succeeded", found["failure"]
    content = client.get(f"{report}.pdf").content
    if len(sys.argv) > 1:
        Path(sys.argv[1], f"{kind}.pdf").write_bytes(content)
    page = pypdfium2.PdfDocument(content)[0].render(scale=_SCALE).to_pil()
    page.quantize(48).save(FOLDER / f"report-{kind}.png", optimize=True)


if __name__ == "__main__":
    main()
