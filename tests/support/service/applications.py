"""Fixtures that run the real application on a data folder of its own, for the tests of `app` and of its pages."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import Any

import httpx2
import pytest
import uvicorn
from starlette.testclient import TestClient

from app.blobs import LocalBlobs
from app.jobs import call_queue, worker_pool
from app.main import create_app
from app.services.installation.context import ServiceContext
from app.settings import Settings
from tests.support.environment.side_processes import SideProcesses
from tests.support.service.service import Api, ApiMaker, wait_until


@pytest.fixture(scope="session")
def empty_data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder as the first start leaves it, to be copied: migrating anew for every test costs more."""
    folder = tmp_path_factory.mktemp("template") / "data"
    ServiceContext.open(Settings(data_dir=folder, workers=0)).close()
    return folder


@pytest.fixture(scope="session")
def side_processes() -> Iterator[SideProcesses]:
    """Processes that applications take one after another."""
    processes = SideProcesses()
    yield processes
    processes.close()


@pytest.fixture(scope="session")
def open_api(
    empty_data_dir: Path, side_processes: SideProcesses, tmp_path_factory: pytest.TempPathFactory
) -> ApiMaker:
    """Return a function that runs an application with given settings, as a context manager.

    `lent_workers`: its workers may be there already, for tests that are not about their start or end.
    """

    @contextmanager
    def run(data_dir: Path | None = None, *, lent_workers: bool = False, **settings: Any) -> Iterator[Api]:
        is_empty = data_dir is None
        if data_dir is None:
            data_dir = tmp_path_factory.mktemp("api") / "data"
            shutil.copytree(empty_data_dir, data_dir)
        values: dict[str, Any] = {"workers": 0, "disk_floor_bytes": 0, **settings}
        app = create_app(Settings(data_dir=data_dir, **values))
        with ExitStack() as stack:
            if lent_workers:
                stack.enter_context(workers_lent(side_processes))
            # A loopback name: without keys, the service answers to no other.
            with _no_folders_beforehand() if is_empty else nullcontext(), processes_lent(side_processes):
                client = stack.enter_context(TestClient(app, base_url="http://localhost"))
            api = Api(client, app.state.service)
            client.headers.update(api.key("admin"))
            yield api

    return run


@contextmanager
def _no_folders_beforehand() -> Iterator[None]:
    """Let uploads make the folders of their originals: all 256 cost each start on an empty data folder 50 ms."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LocalBlobs, "prepare", LocalBlobs.clear_incoming)
        yield


@contextmanager
def processes_lent(side_processes: SideProcesses) -> Iterator[None]:
    """Let an application that starts meanwhile take processes that are there already."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(call_queue, "SubprocessExecutor", side_processes.lend)
        yield


@contextmanager
def workers_lent(side_processes: SideProcesses) -> Iterator[None]:
    """The same of workers, as long as the application runs: it starts them when it needs them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker_pool, "WorkerProcess", side_processes.lend_worker)
        yield


@pytest.fixture(scope="session")
def serve_api(
    empty_data_dir: Path, side_processes: SideProcesses, tmp_path_factory: pytest.TempPathFactory
) -> ApiMaker:
    """Return what opens an application behind a real server, whose clients can leave before the answer."""

    @contextmanager
    def run(*, lent_workers: bool = False, **settings: Any) -> Iterator[Api]:
        data_dir = tmp_path_factory.mktemp("served") / "data"
        shutil.copytree(empty_data_dir, data_dir)
        app = create_app(Settings(data_dir=data_dir, **{"workers": 0, "disk_floor_bytes": 0, **settings}))
        server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_config=None))
        thread = threading.Thread(target=server.run)
        with ExitStack() as stack:
            if lent_workers:
                stack.enter_context(workers_lent(side_processes))
            with processes_lent(side_processes):
                thread.start()
                wait_until(lambda: server.started or not thread.is_alive(), 120.0, "the server listens")
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
