"""JSON bodies: read more strictly than the standard library does, and no larger than allowed.

Large bodies are few in memory at a time, and are read in a thread and in pieces, so that the event loop gets its turn.
The framework validates bodies on the event loop. It is handed the finished models, which it takes as they are.
"""

from __future__ import annotations

import asyncio
import gc
import json
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Annotated, Any, NoReturn, get_origin

from annotated_types import MaxLen
from pydantic import BaseModel, Field, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from app.api.problems import incomplete_body
from app.errors import InvalidContent, TooLarge, Unavailable, UnsupportedContent
from app.http import invalid_request

MIB = 1024 * 1024
MAX_COMMAS = 700_000
MAX_LISTS = 150_000
"""Bounds of what the interpreter's lock is held for: the decoder gives it up at objects, not within lists of numbers.
The largest bulk lists have nine tenths of either.
"""
MAX_FIELDS = 1000
"""Of one object; none in the contract has a twentieth. Each unknown one would be an error to report."""


def stated_length(request: Request, limit: int) -> int | None:
    """Return how many bytes the body is said to have, None where nothing is; raise TooLarge beyond `limit`."""
    stated = request.headers.get("content-length", "")
    if not stated.isdecimal():
        return None
    if int(stated) > limit:
        raise _too_large(limit)
    return int(stated)


async def read_body(request: Request, limit: int) -> bytes:
    """Return the body, or raise TooLarge as soon as it is known to exceed `limit` bytes."""
    stated_length(request, limit)
    chunks: list[bytes] = []
    size = 0
    try:
        async for chunk in request.stream():
            size += len(chunk)
            if size > limit:
                raise _too_large(limit)
            chunks.append(chunk)
    except ClientDisconnect:
        raise incomplete_body("body") from None
    return b"".join(chunks)


def require_json(request: Request, *, takes_csv: bool = False) -> None:
    """Raise UnsupportedContent unless the body is said to be JSON; `takes_csv` says whether it might be CSV."""
    media_type = stated_media_type(request)
    if media_type != "application/json" and not media_type.endswith("+json"):
        raise UnsupportedContent(
            "The body must be JSON or CSV." if takes_csv else "The body must be JSON.",
            f"Send it with Content-Type: application/json{' or text/csv' if takes_csv else ''}.",
        )


def stated_media_type(request: Request) -> str:
    """Return what the body is said to be, in lower case and without parameters."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def parse(body: bytes) -> Any:
    """Return the value of a JSON text; refuse what is no JSON, NaN, infinities, repeated names and lone surrogates.

    Raises InvalidContent, or TooLarge for more values than the largest list has.
    """
    if body.count(b",") > MAX_COMMAS or body.count(b"[") > MAX_LISTS:
        raise TooLarge("The body holds more values than any list may have.", "Send fewer items at a time.")
    try:
        text = body.decode("utf-8")
        value = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_object)
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        raise _invalid(str(error) if isinstance(error, _Refused) else "is not valid JSON") from None
    if "\\u" in text:
        _check_text(value)
    return value


def _too_large(limit: int) -> TooLarge:
    return TooLarge(f"The body has more than {limit} bytes.", "Send less at a time.")


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
    if len(pairs) > MAX_FIELDS:
        raise _Refused(f"holds an object with more than {MAX_FIELDS} fields")
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


INLINE_LIMIT = 64 * 1024
"""Larger bodies are not read on the event loop."""
IN_MEMORY = 4
"""Large bodies that are received or worked on at a time; of them no key has more than half."""
WAITING = 32
"""More that may wait until their first byte is read; a key has at most half of all."""
_MAX_WAIT_S = 60.0
_ARRIVES_WITHIN_S = 300.0
"""16 MiB over half a megabit a second; whoever sends more slowly keeps a place from others."""
_PIECE = 200
_MAX_ERRORS = 100


class BodyPlaces:
    """Places for large bodies, to be taken before any of a body is read. For one event loop."""

    def __init__(self) -> None:
        self._places = asyncio.Semaphore(IN_MEMORY)
        self._shares: dict[str, asyncio.Semaphore] = {}
        self._asking: Counter[str | None] = Counter()

    @asynccontextmanager
    async def taken(self, key_id: str | None) -> AsyncIterator[None]:
        """Hold a place for a key, None where no keys are asked for; Unavailable where too many wait or for too long."""
        most = IN_MEMORY + WAITING
        if self._asking.total() >= most or (key_id is not None and self._asking[key_id] >= most // 2):
            raise _busy()
        self._asking[key_id] += 1
        try:
            async with AsyncExitStack() as held:
                try:
                    async with asyncio.timeout(_MAX_WAIT_S):
                        if key_id is not None:
                            share = self._shares.setdefault(key_id, asyncio.Semaphore(max(1, IN_MEMORY // 2)))
                            await held.enter_async_context(share)
                        await held.enter_async_context(self._places)
                except TimeoutError:
                    raise _busy() from None
                yield
        finally:
            self._asking[key_id] -= 1
            if not self._asking[key_id]:
                del self._asking[key_id]
                if key_id is not None:
                    self._shares.pop(key_id, None)


@asynccontextmanager
async def arriving() -> AsyncIterator[None]:
    """Limit how long a body that has a place may take to arrive; InvalidContent beyond."""
    try:
        async with asyncio.timeout(_ARRIVES_WITHIN_S):
            yield
    except TimeoutError:
        raise InvalidContent(
            f"The body did not arrive within {_ARRIVES_WITHIN_S:.0f} s.",
            "Send fewer items at a time.",
            code="incomplete_body",
        ) from None


@asynccontextmanager
async def collector_off() -> AsyncIterator[None]:
    """Keep the collector of cyclic garbage from its rounds, which hold every thread, while one body is worked on.

    The many objects of a large body set it off again and again, and none of them is garbage.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class BodyReader:
    """Reads the JSON bodies of one route."""

    def __init__(self, body: FieldInfo) -> None:
        model: Any = Annotated[(body.annotation, Field(), *body.metadata)]  # with metadata or none
        self._adapter: TypeAdapter[Any] = TypeAdapter(model)
        self._is_list = get_origin(body.annotation) is list
        self._most = next((one.max_length for one in body.metadata if isinstance(one, MaxLen)), None)

    def read(self, body: bytes) -> Any:
        """Return the value of a body as the route's model, of a list as a list of models.

        Raises InvalidContent with the first hundred errors, TooLarge for too many values.
        """
        return self.validated(parse(body))

    def validated(self, value: Any) -> Any:
        """Return a value of JSON as the route's model, of a list as a list of models; raises as `read` does."""
        is_list = self._is_list and isinstance(value, list)
        if is_list and self._most is not None and len(value) > self._most:
            raise invalid_request([{"type": "too_long", "loc": (), "ctx": {"max_length": self._most}}])
        # The interpreter's lock is held while a piece is validated, and given up from one to the next.
        pieces = [value[i : i + _PIECE] for i in range(0, len(value), _PIECE)] if is_list else [value]
        found: list[Any] = []
        errors: list[dict[str, Any]] = []
        for number, piece in enumerate(pieces):
            try:
                found.append(self._adapter.validate_python(piece))
            except ValidationError as error:
                errors += [
                    {**one, "loc": _moved(one["loc"], number * _PIECE if is_list else 0)}
                    for one in error.errors(include_url=False)
                ]
            if len(errors) >= _MAX_ERRORS:
                break
        if errors:
            raise invalid_request(errors)
        return [item for piece in found for item in piece] if is_list else found[0]


def _busy() -> Unavailable:
    return Unavailable("Too many large bodies are being received.", "Send it again shortly.", code="busy")


def json_answer(document: BaseModel) -> Response:
    """Return a document as an answer that is encoded already, so that the event loop need not encode it."""
    return Response(document.model_dump_json(), media_type="application/json")


def _moved(location: tuple[int | str, ...], by: int) -> tuple[int | str, ...]:
    """Return an error's place in the whole list from that in a piece of it."""
    first = location[0] if location else None
    return (first + by, *location[1:]) if isinstance(first, int) else location
