"""The OpenAPI document keeps the rules that generated clients rely on."""

from __future__ import annotations

import importlib
import json
import pkgutil
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from app.api import routes
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
            r"(get|list|create|update|put|delete|find|reprocess|retry|revoke|stream)_[a-z_]+", operation_id
        )


def test_the_only_union_is_something_or_null(document: dict[str, Any]) -> None:
    for node in walk(document):
        assert "oneOf" not in node
        assert not isinstance(node.get("type"), list)
        if "anyOf" in node:
            assert len(node["anyOf"]) == 2
            assert [part.get("type") for part in node["anyOf"]].count("null") == 1


SHAPES_OF_CONTRACT = {
    # RFC 9457 has the number of the status, everything of ours its word.
    "status": {"Problem"},
    # The contract counts: grid points of a fit, poses that observe a joint.
    "points": {"ReprojectionRead", "ResidualDistances"},
    "poses": {"DhJoint"},
    # A measurement is excluded by its user, with a reason; analyses list what does not count.
    "excluded": {"MeasurementRead", "MeasurementChange"},
}
QUALIFYING = {"AccuracyIntervals", "RepeatabilityIntervals", "FocalInterval", "DhIdentifiable"}
"""Blocks with the same keys as the block whose values they qualify, by an interval or by yes and no."""


def shape(node: dict[str, Any], schemas: dict[str, Any]) -> str:
    """The type of a property, without null; all objects are one."""
    if "$ref" in node:
        return shape(schemas[node["$ref"].removeprefix("#/components/schemas/")], schemas)
    if "anyOf" in node:
        (node,) = (part for part in node["anyOf"] if part.get("type") != "null")
        return shape(node, schemas)
    if node.get("type") == "array":
        return f"array of {shape(node['items'], schemas)}"
    kind = str(node.get("type", "string" if {"enum", "const"} & set(node) else None))
    return f"{kind} {node['format']}" if "format" in node else kind


def test_one_key_has_one_shape_wherever_it_occurs(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    shapes: dict[str, dict[str, set[str]]] = {}
    for name, schema in schemas.items():
        for key, node in schema.get("properties", {}).items():
            if name not in QUALIFYING and name not in SHAPES_OF_CONTRACT.get(key, set()):
                shapes.setdefault(key, {}).setdefault(shape(node, schemas), set()).add(name)
    assert {key: of_key for key, of_key in shapes.items() if len(of_key) > 1} == {}
    for key, names in SHAPES_OF_CONTRACT.items():
        for name in names:
            assert shape(schemas[name]["properties"][key], schemas) not in shapes[key], (
                "an exception without need"
            )


OWN_OF_EACH = {
    # The contract's own words for a list or a choice that each resource, request or analysis has of its own.
    "items": None,
    "poses": None,
    "joints": {"DhJoint", "Joint", "JointRegionRead", "PlannedJoint"},
    "kind": {"ReportKind", "TargetKind"},
    "method": {"ComparisonMethod", "DhMethod"},
    "source": {"BudgetSource", "Source"},
    "status": {"Health", "DeliveryStatus", "MeasurementStatus"},
    "validation": {"CompensationValidation", "DhValidation", "HandEyeValidationRead"},
    # What qualifies values has the keys of these values.
    "standard_uncertainty": None,
    "interval": {"AccuracyIntervals", "RepeatabilityIntervals"},
    "nominal": {"DhNominal", "PoseErrors"},
    "held_out": {"AccuracyFigures", "HeldOutLens"},
    # A robot's model is its maker's name for it, an identification's one of three.
    "model": {"string", "DhModel"},
    # RFC 9457 names a problem by an address; the contract has the GUM's types of evaluation.
    "type": {"string", "BudgetEvaluation"},
    # Stored reports have these: a verification finds a figure by its place, whichever version made the report.
    "figure": {"string", "BudgetFigure"},
    "points": {"GridPointRead", "ShapePoint"},
    "blocks": {"DhBlocks", "DriftBlock"},
}
"""Keys with several schemas of one shape: which, or None where they are as many as resources or analyses."""


def named_schema(node: dict[str, Any]) -> str:
    """The schema that a property refers to, without null, of a list that of its items; else its type."""
    if "$ref" in node:
        return str(node["$ref"]).removeprefix("#/components/schemas/")
    if "anyOf" in node:
        (node,) = (part for part in node["anyOf"] if part.get("type") != "null")
        return named_schema(node)
    return named_schema(node["items"]) if node.get("type") == "array" else str(node.get("type"))


def test_one_key_has_one_schema_or_one_that_adds_to_it(document: dict[str, Any]) -> None:
    """What a client reads under a key in one answer, it can read under it in all others."""
    schemas = document["components"]["schemas"]
    found: dict[str, set[str]] = {}
    for name, schema in schemas.items():
        for key, node in schema.get("properties", {}).items():
            if name not in QUALIFYING and name not in SHAPES_OF_CONTRACT.get(key, set()):
                found.setdefault(key, set()).add(named_schema(node))

    def differ(names: set[str]) -> bool:
        fields = sorted((set(schemas.get(name, {}).get("properties", {name})) for name in names), key=len)
        return any(not less <= more for less, more in pairwise(fields))

    several = {key: names for key, names in found.items() if differ(names)}
    assert set(several) == set(OWN_OF_EACH), "new, or an exception without need"
    for key, names in OWN_OF_EACH.items():
        assert names is None or several[key] == names, key


def undescribed(document: dict[str, Any]) -> Iterator[str]:
    """Yield each schema, property, operation, parameter, response and tag without a description."""
    for name, schema in document["components"]["schemas"].items():
        if not schema.get("description") and schema["type"] == "object":
            yield name
    for node in walk(document):
        properties = node.get("properties", {})
        if node.get("type") == "object":
            yield from (key for key, value in properties.items() if not value.get("description"))
    for method, path, operation in operations(document):
        place = f"{method} {path}"
        if not operation.get("description"):
            yield place
        for parameter in operation.get("parameters", []):
            if not parameter.get("description"):
                yield f"{place} {parameter['name']}"
        for code, response in operation["responses"].items():
            if not response.get("description"):
                yield f"{place} {code}"
    yield from (tag["name"] for tag in document["tags"] if not tag.get("description"))


def test_everything_is_described(document: dict[str, Any]) -> None:
    assert list(undescribed(document)) == []


def test_descriptions_are_of_whole_sentences(document: dict[str, Any]) -> None:
    for schema in document["components"]["schemas"].values():
        for key, value in schema.get("properties", {}).items():
            assert value["description"].endswith((".", ")")), key
            assert value["description"].strip(".").replace(" ", "_").lower() not in (key, f"the_{key}")


def test_operations_have_the_tags_that_the_document_describes(document: dict[str, Any]) -> None:
    used = {tag for _, _, operation in operations(document) for tag in operation["tags"]}
    assert used == {tag["name"] for tag in document["tags"]}
    assert all(len(operation["tags"]) == 1 for _, _, operation in operations(document))


def test_enumerations_are_named_once_and_referred_to(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    named = {name: schema for name, schema in schemas.items() if "enum" in schema}
    assert len([node for node in walk(document) if "enum" in node and "type" in node]) == len(named)
    values = [tuple(schema["enum"]) for schema in named.values()]
    assert len(set(values)) == len(values), "one enumeration under two names"
    text = json.dumps(document)
    for name in named:
        assert f'"#/components/schemas/{name}"' in text, f"{name} is not referred to"
    assert {"MeasurementStatus", "TargetKind", "Estimator", "CalibrationGrade", "Verdict"} <= set(named)


def test_no_two_schemas_have_one_name(document: dict[str, Any]) -> None:
    """Two of one name get their modules' as well, which no client can use."""
    assert not [name for name in document["components"]["schemas"] if "__" in name]


def test_bounds_are_those_of_json_schema(document: dict[str, Any]) -> None:
    for node in walk(document["components"]["schemas"]):
        if "type" in node and not isinstance(node["type"], dict):  # a schema, not the properties of one
            assert not {"ge", "le", "gt", "lt", "multiple_of", "nullable"} & set(node), node
    for _, path, operation in operations(document):
        for parameter in operation.get("parameters", []):
            assert not {"ge", "le", "gt", "lt", "nullable"} & set(parameter["schema"]), (
                path,
                parameter["name"],
            )


def test_operations_are_called_as_their_functions(document: dict[str, Any]) -> None:
    modules = [
        importlib.import_module(module.name)
        for module in pkgutil.walk_packages(routes.__path__, f"{routes.__name__}.")
    ]
    functions = {name for module in modules for name in vars(module)}
    assert {operation["operationId"] for _, _, operation in operations(document)} <= functions


def test_license_and_server_are_stated(document: dict[str, Any]) -> None:
    assert document["info"]["license"]["identifier"] == "Apache-2.0"
    assert [server["url"] for server in document["servers"]] == ["/"]


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


def test_bounds_of_whole_numbers_are_whole(document: dict[str, Any]) -> None:
    bounds = ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")
    stated = [
        node[name]
        for node in walk(document)
        if node.get("type") == "integer"
        for name in bounds
        if name in node
    ]
    assert len(stated) > 20
    assert all(isinstance(bound, int) for bound in stated)


def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    for node in walk(document):
        if "$ref" in node:
            kind, name = node["$ref"].removeprefix("#/components/").split("/")
            assert name in document["components"][kind]


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
