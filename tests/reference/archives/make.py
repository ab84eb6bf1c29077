"""Write the archive of this version: a small session of grid points of known truth, with two signed reports."""

from __future__ import annotations

import tempfile
from pathlib import Path

from starlette.testclient import TestClient

from app.main import create_app
from app.records.migrations import head_revision
from app.services.archive import archive_session
from app.settings import Settings
from tests.support.service.archives import ROBOT
from tests.support.service.service import Api, wait_until
from tests.support.sessions.stored_sessions import BOARD, board_fields, shoot, store_shots

FOLDER = Path(__file__).parent
KINDS = ("repeatability", "camera")


def make() -> Path:
    """Return the archive just written; one that is there stays."""
    path = FOLDER / f"schema-{head_revision()}.tar.gz"
    with tempfile.TemporaryDirectory() as folder:
        app = create_app(Settings(data_dir=Path(folder) / "data", workers=0, disk_floor_bytes=0))
        with TestClient(app, base_url="http://localhost") as client:
            api = Api(client, app.state.service)
            client.headers.update(api.key("admin"))
            session = _session(api)
            for kind in KINDS:
                report = client.post(f"/v1/sessions/{session}/reports", json={"kind": kind}).json()["id"]
                wait_until(lambda: _status(api, report) == "succeeded", 300.0, "the report is made")  # noqa: B023
            archive_session(api.installation, session, path)
    return path


def _session(api: Api) -> str:
    robot = api.client.post("/v1/robots", json=ROBOT).json()["id"]
    target = api.make_target(**board_fields(BOARD))
    session = api.make_session(target, name="Archived", robot_id=robot, conditions={"load_kg": 5.0})
    store_shots(api, session, shoot(poses=2, cycles=5), target)
    return session


def _status(api: Api, report: str) -> str:
    return str(api.client.get(f"/v1/reports/{report}").json()["status"])


if __name__ == "__main__":
    print(make())
