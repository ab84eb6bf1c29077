"""Operations of the OpenAPI document: all of the contract's, named, tagged, with their problems and media types."""

from __future__ import annotations

import importlib
import pkgutil
import re
from typing import Any

from app.api import routes
from tests.support.contract.document_nodes import operations


def test_operation_ids_are_verb_noun_and_unique(document: dict[str, Any]) -> None:
    ids = [operation["operationId"] for _, _, operation in operations(document)]
    assert len(set(ids)) == len(ids)
    for operation_id in ids:
        assert re.fullmatch(
            r"(get|list|create|update|put|delete|find|reprocess|retry|revoke|stream)_[a-z_]+", operation_id
        )


def test_operations_have_the_tags_that_the_document_describes(document: dict[str, Any]) -> None:
    used = {tag for _, _, operation in operations(document) for tag in operation["tags"]}
    assert used == {tag["name"] for tag in document["tags"]}
    assert all(len(operation["tags"]) == 1 for _, _, operation in operations(document))


def test_operations_are_called_as_their_functions(document: dict[str, Any]) -> None:
    modules = [
        importlib.import_module(module.name)
        for module in pkgutil.walk_packages(routes.__path__, f"{routes.__name__}.")
    ]
    functions = {name for module in modules for name in vars(module)}
    assert {operation["operationId"] for _, _, operation in operations(document)} <= functions


def test_every_problem_is_declared_as_one(document: dict[str, Any]) -> None:
    reference = {"$ref": "#/components/schemas/Problem"}
    for method, path, operation in operations(document):
        codes = set(operation["responses"])
        for code, response in operation["responses"].items():
            if code.startswith(("4", "5")):
                assert set(response["content"]) == {"application/problem+json"}, (method, path)
                assert response["content"]["application/problem+json"]["schema"] == reference
        if path not in ("/livez", "/readyz"):
            assert {"401", "403"} <= codes, (method, path)
        if "{" in path:
            assert "404" in codes, (method, path)
        if "requestBody" in operation:
            assert {"413", "415", "422"} <= codes, (method, path)
        if any(parameter["in"] == "query" for parameter in operation.get("parameters", [])):
            assert "422" in codes, (method, path)
    assert "HTTPValidationError" not in document["components"]["schemas"]


def test_health_needs_no_key_and_everything_else_does(document: dict[str, Any]) -> None:
    assert document["security"] == [{"key": []}]
    open_paths = {path for _, path, operation in operations(document) if operation.get("security") == []}
    assert open_paths == {"/livez", "/readyz"}


def test_images_and_metrics_declare_their_media_types(document: dict[str, Any]) -> None:
    def media(path: str) -> set[str]:
        return set(document["paths"][path]["get"]["responses"]["200"]["content"])

    octets = "application/octet-stream"
    image = "/v1/measurements/{measurement_id}"
    assert media(f"{image}/image") == {"image/png", "image/jpeg", "image/tiff", "image/bmp", octets}
    assert media(f"{image}/overlay") == {"image/png", "image/webp", octets}
    assert media(f"{image}/thumbnail") == {"image/webp", octets}
    plots = [path for path in document["paths"] if path.endswith(".svg")]
    assert plots
    assert all(media(path) == {"image/svg+xml", octets} for path in plots)
    assert media("/metrics") == {"text/plain"}
    assert media("/v1/sessions/{session_id}/events") == {"text/event-stream"}
    upload = document["paths"]["/v1/sessions/{session_id}/poses/{pose_id}/images/{sha256}"]["put"]
    assert set(upload["requestBody"]["content"]) == {octets}
    assert {"200", "202"} <= set(upload["responses"])


def test_the_contract_is_all_there(document: dict[str, Any]) -> None:
    assert sorted(f"{method.upper()} {path}" for method, path, _ in operations(document)) == [
        "DELETE /v1/keys/{key_id}",
        "DELETE /v1/measurements/{measurement_id}",
        "DELETE /v1/robots/{robot_id}",
        "DELETE /v1/robots/{robot_id}/events/{event_id}",
        "DELETE /v1/sessions/{session_id}",
        "DELETE /v1/sessions/{session_id}/measured-poses",
        "DELETE /v1/targets/{target_id}",
        "DELETE /v1/webhooks/{webhook_id}",
        "GET /livez",
        "GET /metrics",
        "GET /readyz",
        "GET /v1/audit",
        "GET /v1/keys",
        "GET /v1/keys/{key_id}",
        "GET /v1/measurements/{measurement_id}",
        "GET /v1/measurements/{measurement_id}/image",
        "GET /v1/measurements/{measurement_id}/overlay",
        "GET /v1/measurements/{measurement_id}/thumbnail",
        "GET /v1/qualifications",
        "GET /v1/qualifications/{qualification_id}",
        "GET /v1/reports",
        "GET /v1/reports/{report_id}",
        "GET /v1/reports/{report_id}.csv",
        "GET /v1/reports/{report_id}.html",
        "GET /v1/reports/{report_id}.json",
        "GET /v1/reports/{report_id}.pdf",
        "GET /v1/reports/{report_id}.sig",
        "GET /v1/reports/{report_id}.xml",
        "GET /v1/reports/{report_id}/comparison/{other_report_id}",
        "GET /v1/reports/{report_id}/verify",
        "GET /v1/robots",
        "GET /v1/robots/{robot_id}",
        "GET /v1/robots/{robot_id}/events",
        "GET /v1/robots/{robot_id}/history",
        "GET /v1/robots/{robot_id}/history.svg",
        "GET /v1/sessions",
        "GET /v1/sessions/{session_id}",
        "GET /v1/sessions/{session_id}/camera-poses",
        "GET /v1/sessions/{session_id}/comparison",
        "GET /v1/sessions/{session_id}/dh",
        "GET /v1/sessions/{session_id}/dh/error-map",
        "GET /v1/sessions/{session_id}/dh/error-map.svg",
        "GET /v1/sessions/{session_id}/dh/identifiability.svg",
        "GET /v1/sessions/{session_id}/dh/joint-curves.svg",
        "GET /v1/sessions/{session_id}/events",
        "GET /v1/sessions/{session_id}/hand-eye",
        "GET /v1/sessions/{session_id}/intrinsics",
        "GET /v1/sessions/{session_id}/intrinsics/export",
        "GET /v1/sessions/{session_id}/intrinsics/lens.svg",
        "GET /v1/sessions/{session_id}/intrinsics/projection-uncertainty.svg",
        "GET /v1/sessions/{session_id}/intrinsics/residuals.svg",
        "GET /v1/sessions/{session_id}/joint-noise",
        "GET /v1/sessions/{session_id}/joint-noise/map.svg",
        "GET /v1/sessions/{session_id}/measured-poses",
        "GET /v1/sessions/{session_id}/measurements",
        "GET /v1/sessions/{session_id}/poses",
        "GET /v1/sessions/{session_id}/poses/{pose_id}",
        "GET /v1/sessions/{session_id}/repeatability",
        "GET /v1/sessions/{session_id}/repeatability/drift.svg",
        "GET /v1/sessions/{session_id}/repeatability/scatter.svg",
        "GET /v1/sessions/{session_id}/repeatability/steadiness.svg",
        "GET /v1/sessions/{session_id}/reports",
        "GET /v1/targets",
        "GET /v1/targets/{target_id}",
        "GET /v1/webhooks",
        "GET /v1/webhooks/{webhook_id}",
        "GET /v1/webhooks/{webhook_id}/deliveries",
        "PATCH /v1/keys/{key_id}",
        "PATCH /v1/measurements/{measurement_id}",
        "PATCH /v1/robots/{robot_id}",
        "PATCH /v1/sessions/{session_id}",
        "PATCH /v1/targets/{target_id}",
        "POST /v1/keys",
        "POST /v1/measurements/{measurement_id}/retry",
        "POST /v1/robots",
        "POST /v1/robots/{robot_id}/compensate",
        "POST /v1/robots/{robot_id}/dh-plan",
        "POST /v1/robots/{robot_id}/events",
        "POST /v1/sessions",
        "POST /v1/sessions/{session_id}/images",
        "POST /v1/sessions/{session_id}/images/missing",
        "POST /v1/sessions/{session_id}/measured-poses",
        "POST /v1/sessions/{session_id}/next-view",
        "POST /v1/sessions/{session_id}/poses",
        "POST /v1/sessions/{session_id}/qualification",
        "POST /v1/sessions/{session_id}/qualifications",
        "POST /v1/sessions/{session_id}/reports",
        "POST /v1/sessions/{session_id}/reprocess",
        "POST /v1/targets",
        "POST /v1/webhooks",
        "POST /v1/webhooks/{webhook_id}/deliveries/{delivery_id}/redeliver",
        "POST /v1/webhooks/{webhook_id}/test",
        "PUT /v1/sessions/{session_id}/poses/{pose_id}",
        "PUT /v1/sessions/{session_id}/poses/{pose_id}/images/{sha256}",
    ]
