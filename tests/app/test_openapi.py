"""The OpenAPI document keeps the rules that generated clients rely on."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.main import create_app
from app.settings import Settings

METHODS = ("get", "put", "post", "patch", "delete")


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    """The document, made without a data folder."""
    app = create_app(Settings(data_dir=Path("/nonexistent/gridpose")))
    return app.openapi()


def operations(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, item in document["paths"].items():
        for method, operation in item.items():
            assert method in METHODS
            yield method, path, operation


def walk(node: Any) -> Iterator[dict[str, Any]]:
    if isinstance(node, dict):
        yield node
        for value in node.values():
            yield from walk(value)
    elif isinstance(node, list):
        for value in node:
            yield from walk(value)


def test_operation_ids_are_verb_noun_and_unique(document: dict[str, Any]) -> None:
    ids = [operation["operationId"] for _, _, operation in operations(document)]
    assert len(set(ids)) == len(ids)
    for operation_id in ids:
        assert re.fullmatch(
            r"(get|list|create|update|put|delete|find|retry|revoke|stream)_[a-z_]+", operation_id
        )


def test_the_only_union_is_something_or_null(document: dict[str, Any]) -> None:
    for node in walk(document):
        assert "oneOf" not in node
        assert not isinstance(node.get("type"), list)
        if "anyOf" in node:
            assert len(node["anyOf"]) == 2
            assert [part.get("type") for part in node["anyOf"]].count("null") == 1


def test_every_problem_is_declared_as_one(document: dict[str, Any]) -> None:
    reference = {"$ref": "#/components/schemas/Problem"}
    for method, path, operation in operations(document):
        codes = set(operation["responses"])
        for code, response in operation["responses"].items():
            if code.startswith(("4", "5")):
                assert response["content"] == {"application/problem+json": {"schema": reference}}, (
                    method,
                    path,
                )
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


def test_pictures_and_metrics_declare_their_media_types(document: dict[str, Any]) -> None:
    def media(path: str) -> set[str]:
        return set(document["paths"][path]["get"]["responses"]["200"]["content"])

    assert media("/v1/measurements/{measurement_id}/image") == {
        "image/png",
        "image/jpeg",
        "image/tiff",
        "image/bmp",
    }
    assert media("/v1/measurements/{measurement_id}/overlay") == {"image/png"}
    assert media("/metrics") == {"text/plain"}
    assert media("/v1/sessions/{session_id}/events") == {"text/event-stream"}
    upload = document["paths"]["/v1/sessions/{session_id}/poses/{pose_id}/images/{sha256}"]["put"]
    assert set(upload["requestBody"]["content"]) == {"application/octet-stream", "image/*"}
    assert {"200", "202"} <= set(upload["responses"])


def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    for node in walk(document):
        if "$ref" in node:
            assert node["$ref"].removeprefix("#/components/schemas/") in schemas


def test_the_contract_is_all_there(document: dict[str, Any]) -> None:
    assert sorted(f"{method.upper()} {path}" for method, path, _ in operations(document)) == [
        "DELETE /v1/keys/{key_id}",
        "DELETE /v1/sessions/{session_id}",
        "GET /livez",
        "GET /metrics",
        "GET /readyz",
        "GET /v1/keys",
        "GET /v1/keys/{key_id}",
        "GET /v1/measurements/{measurement_id}",
        "GET /v1/measurements/{measurement_id}/image",
        "GET /v1/measurements/{measurement_id}/overlay",
        "GET /v1/robots",
        "GET /v1/robots/{robot_id}",
        "GET /v1/sessions",
        "GET /v1/sessions/{session_id}",
        "GET /v1/sessions/{session_id}/comparison",
        "GET /v1/sessions/{session_id}/dh",
        "GET /v1/sessions/{session_id}/events",
        "GET /v1/sessions/{session_id}/intrinsics",
        "GET /v1/sessions/{session_id}/intrinsics/residuals.svg",
        "GET /v1/sessions/{session_id}/measured-poses",
        "GET /v1/sessions/{session_id}/measurements",
        "GET /v1/sessions/{session_id}/poses",
        "GET /v1/sessions/{session_id}/poses/{pose_id}",
        "GET /v1/sessions/{session_id}/repeatability",
        "GET /v1/sessions/{session_id}/repeatability/drift.svg",
        "GET /v1/sessions/{session_id}/repeatability/scatter.svg",
        "GET /v1/targets",
        "GET /v1/targets/{target_id}",
        "PATCH /v1/sessions/{session_id}",
        "POST /v1/keys",
        "POST /v1/measurements/{measurement_id}/retry",
        "POST /v1/robots",
        "POST /v1/robots/{robot_id}/dh-plan",
        "POST /v1/sessions",
        "POST /v1/sessions/{session_id}/images",
        "POST /v1/sessions/{session_id}/images/missing",
        "POST /v1/sessions/{session_id}/measured-poses",
        "POST /v1/sessions/{session_id}/poses",
        "POST /v1/targets",
        "PUT /v1/sessions/{session_id}/poses/{pose_id}",
        "PUT /v1/sessions/{session_id}/poses/{pose_id}/images/{sha256}",
    ]
