"""A real run of the application on a new data folder, recorded: the examples of the OpenAPI document."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from starlette.testclient import TestClient

from app.main import create_app
from app.settings import Settings
from tests.support.contract import refusals, story
from tests.support.contract.contract import Contract
from tests.support.contract.recording import Recorder
from tests.support.image.images import small_image
from tests.support.service.service import OCTETS, Api, image_address


def record_examples(folder: Path) -> dict[str, Any]:
    """Return what `examples.json` is to hold: each body of every operation, and one problem of each status."""
    contract = Contract(create_app(Settings(data_dir=folder / "none")).openapi())
    recorder = Recorder(contract)
    with _running(folder / "cell", recorder, workers=1) as api:
        story.use_every_operation(api)
        image = small_image(1)
        refusals.refusals(api)
        refusals.ask_for_nothing(api, contract.operations)
        refusals.over_quota(api, image)
        api.service.begin_shutdown()
        assert api.client.get("/readyz").status_code == 503
    with _running(folder / "cell", recorder, workers=0, disk_floor_bytes=2**60) as api:
        full = api.client.put(image_address(api.make_session(), image), content=image, headers=OCTETS)
        assert full.status_code == 507, full.text
    with (
        _running(folder / "cell", recorder, workers=0) as api,
        patch.object(api.service.metrics, "render", side_effect=RuntimeError("a defect")),
    ):
        assert api.client.get("/metrics").status_code == 500
    return recorder.examples()


@contextmanager
def _running(data_dir: Path, recorder: Recorder, **settings: Any) -> Iterator[Api]:
    app = create_app(Settings(data_dir=data_dir, **{"disk_floor_bytes": 0, **settings}))
    # A loopback name: without keys, the service answers to no other.
    address = ("127.0.0.1", 50000)
    with TestClient(
        app, base_url="http://localhost", client=address, raise_server_exceptions=False
    ) as client:
        api = Api(client, app.state.service)
        client.headers.update(api.key("admin"))
        client.event_hooks = {"response": [recorder.hear]}
        yield api
