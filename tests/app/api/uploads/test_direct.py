"""The direct way of an upload and the documented one are the same."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest
from starlette.routing import Match

from app.api.direct import DirectRoute
from app.api.responses import measurement_document
from app.api.routes import images
from app.services.measurements import get_measurement

DIRECT = {
    ("PUT", "/v1/sessions/{session_id}/poses/{pose_id}/images/{sha256}"): "put_image",
    ("POST", "/v1/sessions/{session_id}/images"): "create_image",
}


def test_every_direct_route_is_documented_and_found_by_the_router_too(api: Any) -> None:
    app = api.client.app
    routes = [route for route in images.router.routes if isinstance(route, DirectRoute)]
    assert {(next(iter(r.methods or ())), r.path): r.name for r in routes} == DIRECT
    for (method, path), operation in DIRECT.items():
        assert app.openapi()["paths"][path][method.lower()]["operationId"] == operation
        address = path.replace("{session_id}", "s").replace("{pose_id}", "p").replace("{sha256}", "0")
        scope = {"type": "http", "method": method, "path": address, "root_path": "", "headers": []}
        found = next(r for r in app.router.routes if r.matches(dict(scope))[0] is Match.FULL)
        assert found.matches(dict(scope))[0] is Match.FULL


@pytest.mark.parametrize(
    "metadata",
    [
        {},
        {
            "cycle": 3,
            "focus_group": "näh",
            "joint_angles_deg": "1,-2.5,1e-7,123456.125",
            "captured_at": "2026-01-31T12:00:00Z",
            "filename": 'ä"\\ 1.png',
        },
        {"captured_at": "2026-01-31T12:00:00.000001Z"},
    ],
)
def test_the_answer_to_a_new_image_is_its_document_in_the_same_order(
    api: Any, grey_png: bytes, metadata: dict[str, Any]
) -> None:
    answer = api.put_image(api.make_session(), grey_png, **metadata)
    assert answer.status_code == 202, answer.text
    with api.installation.database.read() as records:
        detail = get_measurement(records, answer.json()["id"])
    model = measurement_document(detail)
    assert answer.json() == model.model_dump(mode="json")
    assert list(answer.json()) == list(type(model).model_fields)
    assert answer.headers["content-type"] == "application/json"
    assert datetime.fromisoformat(answer.json()["received_at"]) <= datetime.now(UTC)


def test_log_and_metrics_name_the_route(api: Any, grey_png: bytes) -> None:
    api.put_image(api.make_session(), grey_png)
    lines = api.client.get("/metrics").text.splitlines()
    (path,) = [path for method, path in DIRECT if method == "PUT"]
    counted = f'gridpose_http_requests_total{{method="PUT",route="{path}",status="202"}} 1.0'
    assert counted in lines


def test_every_wrong_parameter_is_named_at_once(api: Any, grey_png: bytes) -> None:
    address = f"/v1/sessions/{api.make_session()}/poses/a%20b/images/xyz"
    response = api.client.put(
        address, content=grey_png, params={"cycle": "0", "target_id": "", "captured_at": "x"}
    )
    assert response.status_code == 422
    fields = [error["field"] for error in response.json()["errors"]]
    assert fields == ["pose_id", "sha256", "cycle", "target_id", "captured_at"]
