"""A real application on a data folder of its own, and the images that tests send to it."""

from __future__ import annotations

import math
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import uvicorn
from starlette.testclient import TestClient

from app.main import create_app
from app.services.context import ServiceContext
from app.settings import Settings
from core.simulation.renderer import render
from core.simulation.scenes import standard_scene
from core.targets.specification import TargetSpec
from tests.support.image.images import encode
from tests.support.service.postgres import EITHER_DATABASE, new_database
from tests.support.service.service import Api, ApiMaker, wait_until


@pytest.fixture(scope="session")
def empty_data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder as the first start leaves it, to be copied: migrating anew for every test costs more."""
    folder = tmp_path_factory.mktemp("template") / "data"
    ServiceContext.open(Settings(data_dir=folder, workers=0)).close()
    return folder


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
        # A loopback name: without keys, the service answers to no other.
        with TestClient(app, base_url="http://localhost") as client:
            api = Api(client, app.state.service)
            client.headers.update(api.key("admin"))
            yield api

    return run


@pytest.fixture(scope="session")
def serve_api(empty_data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> ApiMaker:
    """Return what opens an application behind a real server, whose clients can leave before the answer."""

    @contextmanager
    def run(**settings: Any) -> Iterator[Api]:
        data_dir = tmp_path_factory.mktemp("served") / "data"
        shutil.copytree(empty_data_dir, data_dir)
        app = create_app(Settings(data_dir=data_dir, **{"workers": 0, "disk_floor_bytes": 0, **settings}))
        server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_config=None))
        thread = threading.Thread(target=server.run)
        thread.start()
        wait_until(lambda: server.started or not thread.is_alive(), 60.0, "the server listens")
        assert thread.is_alive(), "the server ended"
        port = server.servers[0].sockets[0].getsockname()[1]
        try:
            with httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=120.0) as client:
                api = Api(client, app.state.service)
                client.headers.update(api.key("admin"))
                yield api
        finally:
            app.state.begin_shutdown()
            server.should_exit = True
            thread.join()

    return run


@pytest.fixture
def api(open_api: ApiMaker) -> Iterator[Api]:
    """An application that takes uploads and computes nothing."""
    with open_api() as running:
        yield running


@pytest.fixture(scope="session")
def migrated_postgres(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, str]]:
    """A data folder and its PostgreSQL database as the first start leaves them, to be copied."""
    folder = tmp_path_factory.mktemp("migrated") / "data"
    with new_database() as url:
        ServiceContext.open(Settings(data_dir=folder, database_url=url, workers=0)).close()
        yield folder, url


@pytest.fixture(params=EITHER_DATABASE)
def any_api(request: pytest.FixtureRequest, open_api: ApiMaker, tmp_path: Path) -> Iterator[Api]:
    """The same, once on SQLite and, in the larger tier, once on PostgreSQL."""
    if request.param == "sqlite":
        with open_api() as running:
            yield running
    else:
        folder, template = request.getfixturevalue("migrated_postgres")
        shutil.copytree(folder, tmp_path / "data")
        with new_database(template) as url, open_api(tmp_path / "data", database_url=url) as running:
            yield running


@pytest.fixture(scope="module")
def computing_api(open_api: ApiMaker) -> Iterator[Api]:
    """An application with one worker process."""
    with open_api(workers=1) as running:
        yield running


@pytest.fixture(scope="session")
def board_png() -> bytes:
    """A rendered image of the target."""
    target = TargetSpec("chessboard", 9, 6, 25.0)
    return encode(".png", render(standard_scene(target, seed=1, tilt=math.radians(30.0), clutter=0.0)))


@pytest.fixture(scope="session")
def grey_png() -> bytes:
    """A small image of nothing."""
    return encode(".png", np.full((48, 64), 128, np.uint8))
