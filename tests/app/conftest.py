"""A real application on a data folder of its own, and the pictures that tests send to it."""

from __future__ import annotations

import hashlib
import math
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from starlette.testclient import TestClient

from app.api.contract import Service
from app.main import create_app
from app.services.installation import Installation
from app.services.keys import create_key
from app.settings import Settings
from core.simulation.renderer import render
from core.simulation.scenes import standard_scene
from core.targets.specification import TargetSpec

TARGET = {"name": "board", "kind": "chessboard", "columns": 9, "rows": 6, "pitch_mm": 25.0}


@dataclass(frozen=True)
class Api:
    """A client of one running application, with an admin key."""

    client: TestClient
    service: Service

    @property
    def installation(self) -> Installation:
        return self.service.installation

    def make_target(self, **changes: Any) -> str:
        response = self.client.post("/v1/targets", json={**TARGET, **changes})
        assert response.status_code == 201, response.text
        return str(response.json()["id"])

    def make_session(self, *target_ids: str, **fields: Any) -> str:
        ids = list(target_ids) or [self.make_target()]
        response = self.client.post("/v1/sessions", json={"name": "session", "target_ids": ids, **fields})
        assert response.status_code == 201, response.text
        return str(response.json()["id"])

    def put_image(self, session_id: str, data: bytes, pose_id: str = "P1", **query: Any) -> Any:
        sha256 = hashlib.sha256(data).hexdigest()
        return self.client.put(
            f"/v1/sessions/{session_id}/poses/{pose_id}/images/{sha256}",
            content=data,
            params=query,
            headers={"Content-Type": "application/octet-stream"},
        )

    def key(self, scope: str) -> dict[str, str]:
        """Headers that hold a new key with this scope."""
        return {"Authorization": f"Bearer {create_key(self.installation, scope, scope).secret_key}"}

    def wait_for(self, measurement_id: str, timeout_s: float = 120.0) -> dict[str, Any]:
        """Return a measurement once it is finished."""
        deadline = time.monotonic() + timeout_s
        while True:
            document: dict[str, Any] = self.client.get(f"/v1/measurements/{measurement_id}").json()
            if document["status"] in ("succeeded", "failed"):
                return document
            assert time.monotonic() < deadline, f"still {document['status']} after {timeout_s} s"
            time.sleep(0.02)


@pytest.fixture(scope="session")
def empty_data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder as the first start leaves it, to be copied: migrating anew for every test costs more."""
    folder = tmp_path_factory.mktemp("template") / "data"
    Installation.open(Settings(data_dir=folder, workers=0)).close()
    return folder


ApiMaker = Callable[..., AbstractContextManager[Api]]


@pytest.fixture(scope="session")
def open_api(empty_data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> ApiMaker:
    """Return a function that runs an application with given settings, as a context manager."""

    @contextmanager
    def run(data_dir: Path | None = None, **settings: Any) -> Iterator[Api]:
        if data_dir is None:
            data_dir = tmp_path_factory.mktemp("api") / "data"
            shutil.copytree(empty_data_dir, data_dir)
        values: dict[str, Any] = {"workers": 0, "disk_floor_bytes": 0, **settings}
        app = create_app(Settings(data_dir=data_dir, **values))
        with TestClient(app) as client:
            api = Api(client, app.state.service)
            client.headers.update(api.key("admin"))
            yield api

    return run


@pytest.fixture
def api(open_api: ApiMaker) -> Iterator[Api]:
    """An application that takes uploads and computes nothing."""
    with open_api() as running:
        yield running


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)])
def any_api(request: pytest.FixtureRequest, open_api: ApiMaker, tmp_path: Path) -> Iterator[Api]:
    """The same, once on SQLite and once on PostgreSQL."""
    if request.param == "sqlite":
        with open_api() as running:
            yield running
    else:
        with open_api(tmp_path / "data", database_url=request.getfixturevalue("postgres_url")) as running:
            yield running


@pytest.fixture(scope="module")
def computing_api(open_api: ApiMaker) -> Iterator[Api]:
    """An application with one worker process."""
    with open_api(workers=1) as running:
        yield running


@pytest.fixture(scope="session")
def board_png() -> bytes:
    """A rendered photograph of the target."""
    target = TargetSpec("chessboard", 9, 6, 25.0)
    return encode(".png", render(standard_scene(target, seed=1, tilt=math.radians(30.0), clutter=0.0)))


@pytest.fixture(scope="session")
def grey_png() -> bytes:
    """A small picture of nothing."""
    return encode(".png", np.full((48, 64), 128, np.uint8))


def encode(extension: str, image: Any) -> bytes:
    encoded, buffer = cv2.imencode(extension, image)
    assert encoded
    return bytes(buffer)


@pytest.fixture(scope="session")
def picture() -> Callable[[str, Any], bytes]:
    """Return a function that encodes an array as a file of the format its extension names."""
    return encode
