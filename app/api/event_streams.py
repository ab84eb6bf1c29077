"""Event streams: how many are open, and that each ends with its client, its key or the service."""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator

from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from app.errors import Unavailable

PER_KEY = 8
IN_ALL = 64


class EventStreams:
    """The open streams of one service, counted by key."""

    def __init__(self) -> None:
        self._open: Counter[str | None] = Counter()

    def open(self, key_id: str | None, events: AsyncIterator[str]) -> EventStream:
        """Return a stream of a key, None where no keys are asked for.

        Raises Unavailable where the key, or all together, have as many as they may.
        """
        if key_id is not None and self._open[key_id] >= PER_KEY:
            raise Unavailable(
                f"This key follows {PER_KEY} sessions already, which is as many as one key may.",
                "Close another event stream, or poll the session instead.",
                code="too_many_streams",
            )
        if self._open.total() >= IN_ALL:
            raise Unavailable(
                f"{IN_ALL} event streams are open, which is as many as the service serves.",
                "Ask again later, or poll the session instead.",
                code="too_many_streams",
            )
        self._open[key_id] += 1
        return EventStream(self, key_id, events)

    def close(self, key_id: str | None) -> None:
        """Count one stream of a key less."""
        self._open[key_id] -= 1
        if not self._open[key_id]:
            del self._open[key_id]

    def count(self) -> int:
        """Return how many are open."""
        return self._open.total()


class EventStream(StreamingResponse):
    """Server-sent events; however the answer ends, its place is free again."""

    def __init__(self, streams: EventStreams, key_id: str | None, events: AsyncIterator[str]) -> None:
        super().__init__(events, media_type="text/event-stream")
        self._streams, self._key_id = streams, key_id

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._streams.close(self._key_id)
