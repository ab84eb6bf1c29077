"""The client of a request: its key, and work that ends when its connection closes."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Request

from app.records.tables import ApiKey

Answer = TypeVar("Answer")


class ClientDisconnected(Exception):
    """The client closed its connection before there was an answer."""


def key_of(request: Request) -> ApiKey | None:
    """Return the valid key that the request carries; None without one, or where no keys are asked for."""
    key = getattr(request.state, "key", None)
    assert key is None or isinstance(key, ApiKey)
    return key


async def get_requester(request: Request) -> str | None:
    """Return the id of the request's key, by which shares are counted; None where no keys are asked for."""
    key = key_of(request)
    return key.id if key is not None else None


RequesterDep = Annotated[str | None, Depends(get_requester)]


async def run_while_connected(request: Request, work: Coroutine[Any, Any, Answer]) -> Answer:
    """Return what `work` returns; cancel it and raise ClientLeft where the client goes away first.

    The request's body must have been read, or the request must have none.
    """
    working = asyncio.create_task(work)
    leaving = asyncio.create_task(_await_departure(request))
    try:
        await asyncio.wait((working, leaving), return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise ClientDisconnected
        return working.result()
    finally:
        for task in (working, leaving):
            task.cancel()
        await asyncio.wait((working, leaving))


async def _await_departure(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
