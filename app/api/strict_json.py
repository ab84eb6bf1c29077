"""Reading JSON bodies more strictly than the standard library does, and no larger than allowed."""

from __future__ import annotations

import json
from typing import Any, NoReturn

from starlette.requests import ClientDisconnect, Request

from app.errors import InvalidContent, TooLarge, UnsupportedContent

MIB = 1024 * 1024


async def read_body(request: Request, limit: int) -> bytes:
    """Return the body, or raise TooLarge as soon as it is known to exceed `limit` bytes."""
    too_large = TooLarge(f"The body has more than {limit} bytes.", "Send less at a time.")
    stated = request.headers.get("content-length", "")
    if stated.isdecimal() and int(stated) > limit:
        raise too_large
    chunks: list[bytes] = []
    size = 0
    try:
        async for chunk in request.stream():
            size += len(chunk)
            if size > limit:
                raise too_large
            chunks.append(chunk)
    except ClientDisconnect:
        raise InvalidContent(
            "The client went away before the body was complete.", code="incomplete_body"
        ) from None
    return b"".join(chunks)


def require_json(request: Request) -> None:
    """Raise UnsupportedContent unless the body is said to be JSON."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != "application/json" and not media_type.endswith("+json"):
        raise UnsupportedContent("The body must be JSON.", "Send it with Content-Type: application/json.")


def parse(body: bytes) -> Any:
    """Return the value of a JSON text; refuse what is no JSON, NaN, infinities, repeated names and lone surrogates."""
    try:
        text = body.decode("utf-8")
        value = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_object)
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        raise _invalid(str(error) if isinstance(error, _Refused) else "is not valid JSON") from None
    if "\\u" in text:
        _check_text(value)
    return value


class _Refused(ValueError):
    pass


def _invalid(message: str) -> InvalidContent:
    return InvalidContent(
        "The body is not valid JSON.",
        "Send one JSON value in UTF-8.",
        code="invalid_json",
        errors=[("body", message)],
    )


def _refuse_constant(_name: str) -> NoReturn:
    raise _Refused("holds NaN or an infinity")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise _Refused("holds an object that names a field twice")
    return value


def _check_text(value: Any) -> None:
    """Refuse text with lone surrogates anywhere, names of fields included: it cannot be stored or answered."""
    pending = [value]
    while pending:
        item = pending.pop()
        if isinstance(item, str):
            try:
                item.encode("utf-8")
            except UnicodeEncodeError:
                raise _invalid("holds text that is not valid Unicode") from None
        elif isinstance(item, dict):
            pending.extend(item.keys())
            pending.extend(item.values())
        elif isinstance(item, list):
            pending.extend(item)
