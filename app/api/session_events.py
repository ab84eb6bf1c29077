"""The events of one session: what is sent to whoever follows it, and when."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncIterator
from typing import Any

from starlette.concurrency import run_in_threadpool

from app.api.dependencies import AppContext
from app.errors import ServiceError
from app.services.following import Look, Position, Start, look
from app.services.keys import is_in_force
from app.services.sessions import Counts

KEEP_ALIVE_S = 15.0
"""How long a stream is silent where nothing happens."""
RECOUNT_S = 10.0
"""How often counts are read although no status changed and no news were announced."""
_KEEP_ALIVE = ": still here\n\n"


async def follow(
    service: AppContext, key_id: str | None, session_id: str, begin: Start
) -> AsyncIterator[str]:
    """Yield a session's events until it is deleted, the key is no longer valid, or the service stops.

    Nothing is kept but the position and the counts sent last: what a slow client has not taken is read when it has.
    """
    position, counts = begin
    yield _progress(session_id, counts, position)
    sent_s = counted_s = time.monotonic()
    was_woken = False
    with service.news.following(session_id) as news:
        while not service.stopping:
            recount = was_woken or time.monotonic() - counted_s >= RECOUNT_S
            try:
                is_allowed, found = await run_in_threadpool(
                    _look, service, key_id, session_id, position, recount
                )
            except ServiceError:  # it is logged where it arose; a busy database passes
                yield _KEEP_ALIVE
                was_woken |= await news.wait()
                continue
            if not is_allowed:
                return
            if found is None:
                yield _event("deleted", {"session_id": session_id})
                return
            text = _events(session_id, found, counts)
            position = found.position
            if found.counts is not None:
                counts, counted_s, was_woken = found.counts, time.monotonic(), False
            if text or time.monotonic() - sent_s >= KEEP_ALIVE_S:
                yield text or _KEEP_ALIVE
                sent_s = time.monotonic()
            if not found.has_more:
                was_woken |= await news.wait(soon=not found.are_all)


def _look(
    service: AppContext, key_id: str | None, session_id: str, after: Position, recount: bool
) -> tuple[bool, Look | None]:
    """Return whether the stream's key is still valid, and what changed in the session."""
    if key_id is not None and not is_in_force(service.installation, key_id):
        return False, None
    return True, look(service.installation.database, session_id, after, recount=recount)


def _events(session_id: str, found: Look, counts: Counts) -> str:
    """Return the events of what one look found, "" where nothing changed; `counts` are those sent last."""
    if found.changes:
        return "".join(
            _event(
                "measurement",
                {
                    "measurement_id": change.measurement_id,
                    "pose_id": change.pose_id,
                    "status": change.status,
                    "counts": found.counts,
                },
                change.position,
            )
            for change in found.changes
        )
    if found.counts is not None and found.counts != counts:
        return _progress(session_id, found.counts, found.position)
    return ""


def _progress(session_id: str, counts: Counts, position: Position) -> str:
    pending = counts["queued"] + counts["running"]
    return _event("progress", {"session_id": session_id, "counts": counts, "pending": pending}, position)


def _event(name: str, document: dict[str, Any], position: Position | None = None) -> str:
    id_line = "" if position is None else f"id: {position}\n"
    return f"event: {name}\n{id_line}data: {json.dumps(document)}\n\n"
