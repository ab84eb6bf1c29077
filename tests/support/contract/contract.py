"""Operations of an OpenAPI document by their address, and what their bodies must be."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import jsonschema_rs

METHODS = ("get", "put", "post", "patch", "delete")
JSON_TYPES = ("application/json", "application/problem+json")
TEXT_TYPES = ("application/yaml", "application/xml")
"""Types of text in addition to those of `text/`."""


@dataclass(frozen=True)
class Operation:
    """One operation of the document."""

    method: str
    path: str
    content: dict[str, Any]

    @property
    def operation_id(self) -> str:
        return str(self.content["operationId"])

    @property
    def query_names(self) -> frozenset[str]:
        parameters = self.content.get("parameters", [])
        return frozenset(each["name"] for each in parameters if each["in"] == "query")

    def bodies(self) -> Iterator[tuple[str, str, dict[str, Any]]]:
        """Yield each body: `request` or its response's status, the media type, and what the document says of it."""
        for media_type, content in self.content.get("requestBody", {}).get("content", {}).items():
            yield "request", media_type, content
        for status, response in self.content["responses"].items():
            for media_type, content in response.get("content", {}).items():
                yield status, media_type, content

    def schema(self, place: str, media_type: str = "application/json") -> dict[str, Any]:
        """Return the schema of a body; AssertionError where the operation has no such body."""
        for found, of_type, content in self.bodies():
            if (found, of_type) == (place, media_type):
                schema: dict[str, Any] = content["schema"]
                return schema
        raise AssertionError(f"{self.operation_id} has no {media_type} at {place}")


class Contract:
    """An OpenAPI document whose operations and schemas are looked up."""

    def __init__(self, document: dict[str, Any]) -> None:
        self.document = document
        self._validators: dict[str, jsonschema_rs.Draft202012Validator] = {}
        self.operations = [
            Operation(method, path, content)
            for path, item in document["paths"].items()
            for method, content in item.items()
            if method in METHODS
        ]

    def at(self, method: str, path: str) -> Operation:
        """Return the operation of a request; AssertionError where the document has none."""
        found = [
            operation
            for operation in self.operations
            if operation.method == method.lower()
            and re.fullmatch(re.sub(r"\{[^}]+\}", "[^/]+", operation.path), path)
        ]
        assert found, f"the contract has no {method} {path}"
        return min(found, key=lambda operation: operation.path.count("{"))  # a fixed name before a parameter

    def resolve(self, schema: dict[str, Any]) -> dict[str, Any]:
        """Return a schema without references and without its null."""
        while "$ref" in schema or "anyOf" in schema:
            if "$ref" in schema:
                schema = self.document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
            else:
                (schema,) = (part for part in schema["anyOf"] if part.get("type") != "null")
        return schema

    def violations(self, value: Any, schema: dict[str, Any]) -> list[str]:
        """Return where a body is not what its schema says, keys that the schema does not have included."""
        found = [
            f"{'/'.join(map(str, error.instance_path))}: {error.message[:300]}"
            for error in self._validator(schema).iter_errors(value)
        ]
        return found + [f"{path}: is not in the schema" for path in self._undeclared(value, schema, "")]

    def _validator(self, schema: dict[str, Any]) -> jsonschema_rs.Draft202012Validator:
        """Return what checks against a schema; made once, since the components that it may refer to are many."""
        text = json.dumps(schema)
        if text not in self._validators:
            whole = {**schema, "components": self.document["components"]}
            self._validators[text] = jsonschema_rs.Draft202012Validator(whole)
        return self._validators[text]

    def _undeclared(self, value: Any, schema: dict[str, Any], path: str) -> Iterator[str]:
        schema = self.resolve(schema)
        if isinstance(value, list):
            for index, item in enumerate(value):
                yield from self._undeclared(item, schema.get("items", {}), f"{path}/{index}")
        elif isinstance(value, dict):
            properties, others = schema.get("properties", {}), schema.get("additionalProperties")
            for name, item in value.items():
                if name in properties:
                    yield from self._undeclared(item, properties[name], f"{path}/{name}")
                elif isinstance(others, dict):
                    yield from self._undeclared(item, others, f"{path}/{name}")
                elif others is not True:
                    yield f"{path}/{name}"
