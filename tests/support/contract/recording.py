"""What a client sends and is answered, by operation: the examples of the OpenAPI document."""

from __future__ import annotations

import json
from email.parser import BytesParser
from typing import Any

from tests.support.contract.contract import JSON_TYPES, TEXT_TYPES, Contract

FORM = "multipart/form-data"
_MAX_OBJECTS, _MAX_NUMBERS, _MAX_LINES = 2, 6, 12
_WHOLE = ("joints", "joint_noise", "null_space", "parameters", "verdicts")
_SECRET = "gp_" + "0" * 16 + "_" + "0" * 43
"""What stands for the secret of a key, which nobody is to find in a committed file."""


class Recorder:
    """Keeps the last body of each operation, status and media type, of problems the first; hang `hear` on a client's
    responses.
    """

    def __init__(self, contract: Contract) -> None:
        self._contract = contract
        self.operations: dict[str, dict[str, Any]] = {}
        self.problems: dict[str, Any] = {}

    def hear(self, response: Any) -> None:
        """Take the bodies of a request and of its answer, where they are JSON or text."""
        response.read()
        status = str(response.status_code)
        answered = _body(response)
        operation = self._contract.at(response.request.method, response.request.url.path)
        kept = self.operations.setdefault(operation.operation_id, {"request": {}, "responses": {}})
        if response.is_error:
            if answered is not None:
                self.problems.setdefault(status, answered[1])
                kept["responses"].setdefault(status, {}).setdefault(*answered)
            return
        if status in ("201", "202"):
            assert "location" in response.headers, operation.operation_id
        sent = _body(response.request)
        if sent is not None:
            kept["request"][sent[0]] = sent[1]
        if answered is not None:
            kept["responses"].setdefault(status, {})[answered[0]] = answered[1]

    def examples(self) -> dict[str, Any]:
        """Return all of it, in the document's order."""
        order = [operation.operation_id for operation in self._contract.operations]
        return {
            "operations": {name: self.operations[name] for name in order if name in self.operations},
            "problems": dict(sorted(self.problems.items())),
        }


def _body(message: Any) -> tuple[str, Any] | None:
    """Return media type and shortened body of a request or response; None where it is empty or binary."""
    media_type = message.headers.get("content-type", "").partition(";")[0]
    content = message.content
    if not content:
        return None
    if media_type in JSON_TYPES:
        return media_type, shortened(json.loads(content))
    if media_type == FORM:
        return media_type, _form(message.headers["content-type"], content)
    if media_type.startswith("text/") or media_type in TEXT_TYPES:
        return media_type, "".join(content.decode().splitlines(keepends=True)[:_MAX_LINES])
    return None


def _form(content_type: str, content: bytes) -> dict[str, Any]:
    """Return the fields of a form, its file by name."""
    form = BytesParser().parsebytes(f"Content-Type: {content_type}\r\n\r\n".encode() + content)
    fields: dict[str, Any] = {}
    for part in form.get_payload():
        assert not isinstance(part, str)
        name = str(part.get_param("name", header="content-disposition"))
        text = part.get_filename() or bytes(part.get_payload(decode=True)).decode()
        fields[name] = int(text) if text.isdecimal() else text
    return fields


def shortened(value: Any) -> Any:
    """Return a body with the first two objects or texts, or six numbers or rows of numbers, of each list; whole are
    those that belong to a robot's joints, to what was not determined, and verdicts, one for each figure.
    """
    if isinstance(value, dict):
        return {
            name: _SECRET
            if name == "key" and isinstance(item, str)
            else [shortened(each) for each in item]
            if name in _WHOLE
            else shortened(item)
            for name, item in value.items()
        }
    if isinstance(value, list):
        is_numeric = all(isinstance(item, int | float | list) for item in value)
        return [shortened(item) for item in value[: _MAX_NUMBERS if is_numeric else _MAX_OBJECTS]]
    return value


def keys_of(value: Any, path: str = "") -> set[str]:
    """Return the paths of all keys of a body, items of a list as one."""
    if isinstance(value, dict):
        return {f"{path}/{name}" for name in value} | {
            key for name, item in value.items() for key in keys_of(item, f"{path}/{name}")
        }
    if isinstance(value, list):
        return {key for item in value for key in keys_of(item, f"{path}[]")}
    return set()
