"""One key has one shape and one schema wherever the OpenAPI document has it."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

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
