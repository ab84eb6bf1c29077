"""Who is doing what just now: set where a request or a command begins, read where rows are written.

A context variable carries it, since it follows a request into the thread pool, and no function between needs to pass
it on. Where none is set (the runner, clearing up at start) nothing is audited and nothing is limited.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Literal

ActorKind = Literal["key", "cli", "service", "anonymous"]
"""`cli`: a command on the server itself. `service`: the service of its own accord. `anonymous`: AUTH=off."""


@dataclass(slots=True)
class Activity:
    """One request or command.

    `object_ids` are those the address names, then those changed with them, then those made. `session_ids` are the
    sessions the key is limited to, None where it is not. `audited` is false for what changes nothing.
    """

    actor: ActorKind
    action: str
    key_id: str | None = None
    key_name: str | None = None
    client: str | None = None
    request_id: str | None = None
    object_ids: list[str] = field(default_factory=list)
    session_ids: frozenset[str] | None = None
    has_quota: bool = False
    audited: bool = True


_current: ContextVar[Activity | None] = ContextVar("activity", default=None)


def current_activity() -> Activity | None:
    """Return what is being done here, None where nobody said."""
    return _current.get()


@contextmanager
def acting(activity: Activity) -> Iterator[Activity]:
    """Make `activity` the current one within the block."""
    token = _current.set(activity)
    try:
        yield activity
    finally:
        _current.reset(token)


def note_objects(ids: Iterable[str]) -> None:
    """Add to the current activity the ids of what it changes in addition to what the address names."""
    activity = _current.get()
    if activity is not None:
        activity.object_ids.extend(one for one in ids if one not in activity.object_ids)


def maker() -> str | None:
    """Return what a new row has in `made_by`: the key's id, `cli`, `service`, or None where nobody said."""
    activity = _current.get()
    if activity is None or activity.actor == "anonymous":
        return None
    return activity.key_id if activity.actor == "key" else activity.actor


def maker_name() -> str | None:
    """Return the name of the key that acts; None without one, or where nobody said."""
    activity = _current.get()
    return activity.key_name if activity is not None else None
