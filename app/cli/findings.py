"""One thing `gridpose doctor` looked at."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class State(enum.Enum):
    ok = enum.auto()
    warning = enum.auto()
    failed = enum.auto()


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found, and, unless it is in order, what to do."""

    state: State
    what: str
    advice: str | None = None


def ok(what: str) -> Finding:
    return Finding(State.ok, what)


def warn(what: str, advice: str) -> Finding:
    return Finding(State.warning, what, advice)


def failed(what: str, advice: str) -> Finding:
    return Finding(State.failed, what, advice)
