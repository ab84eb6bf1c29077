"""A client's line to a service on which each request and each reading of an answer is held against the contract."""

from __future__ import annotations

import json
from typing import Any

import httpx2

from tests.support.contract.contract import Contract


class CheckedTransport(httpx2.HTTPTransport):
    """Fails on a request that the contract does not have, on an answer that breaks its schema, and on what is read
    of an answer that its schema does not have. `used` lists the operations that were called.
    """

    def __init__(self, contract: Contract) -> None:
        super().__init__()
        self._contract = contract
        self.used: set[str] = set()

    def handle_request(self, request: httpx2.Request) -> httpx2.Response:
        operation = self._contract.at(request.method, request.url.path)
        self.used.add(operation.operation_id)
        unknown = set(request.url.params) - operation.query_names
        assert not unknown, f"{operation.operation_id} has no query {unknown}"
        content = request.read()
        if request.headers.get("content-type") == "application/json":
            violations = self._contract.violations(json.loads(content), operation.schema("request"))
            assert violations == [], f"{operation.operation_id}: {violations}"
        elif content:
            assert operation.schema("request", request.headers["content-type"])["format"] == "binary"
        response = super().handle_request(request)
        response.read()
        media_type = response.headers.get("content-type", "").partition(";")[0]
        if not response.content or not media_type.endswith("json"):
            return response
        schema = operation.schema(str(response.status_code), media_type)
        violations = self._contract.violations(response.json(), schema)
        assert violations == [], f"{operation.operation_id}: {violations}"
        return _CheckedResponse(self._contract, schema, response)


class _CheckedResponse(httpx2.Response):
    """A response whose JSON is `CheckedAnswer`s."""

    def __init__(self, contract: Contract, schema: dict[str, Any], response: httpx2.Response) -> None:
        headers = [(k, v) for k, v in response.headers.raw if k.lower() not in (b"content-encoding",)]
        super().__init__(response.status_code, headers=headers, content=response.content)
        self._contract, self._schema = contract, schema

    def json(self, **options: Any) -> Any:
        return checked(super().json(**options), self._schema, self._contract)


def checked(value: Any, schema: dict[str, Any], contract: Contract) -> Any:
    """Return a body whose objects fail where a key is read that their schema does not have."""
    if isinstance(value, list):
        items = contract.resolve(schema).get("items", {})
        return [checked(item, items, contract) for item in value]
    if not isinstance(value, dict):
        return value
    schema = contract.resolve(schema)
    known = schema.get("properties", {})
    others = schema.get("additionalProperties")
    if isinstance(others, dict):
        known = {name: known.get(name, others) for name in {*known, *value}}
    return CheckedAnswer({name: checked(item, known[name], contract) for name, item in value.items()}, known)


class CheckedAnswer(dict[str, Any]):
    """An object of an answer that has no keys but those of its schema."""

    def __init__(self, values: dict[str, Any], known: dict[str, Any]) -> None:
        super().__init__(values)
        self._known = frozenset(known)

    def _check(self, name: object) -> None:
        assert name in self._known, f"the contract has no {name!r} among {sorted(self._known)}"

    def __getitem__(self, name: str) -> Any:
        self._check(name)
        return super().__getitem__(name)

    def __contains__(self, name: object) -> bool:
        self._check(name)
        return super().__contains__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self._check(name)
        return super().get(name, default)
