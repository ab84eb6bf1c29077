"""The OpenAPI document keeps the rules that generated clients rely on."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from tests.support.contract.document_nodes import operations, walk


def test_the_only_union_is_something_or_null(document: dict[str, Any]) -> None:
    for node in walk(document):
        assert "oneOf" not in node
        assert not isinstance(node.get("type"), list)
        if "anyOf" in node:
            assert len(node["anyOf"]) == 2
            assert [part.get("type") for part in node["anyOf"]].count("null") == 1


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


def test_license_and_server_are_stated(document: dict[str, Any]) -> None:
    assert document["info"]["license"]["identifier"] == "Apache-2.0"
    assert [server["url"] for server in document["servers"]] == ["/"]


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
