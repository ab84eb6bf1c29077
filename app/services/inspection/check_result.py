"""Result of one check of an installation."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class State(enum.Enum):
    ok = enum.auto()
    warning = enum.auto()
    failed = enum.auto()


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What a check found, and the advice unless the state is ok."""

    state: State
    detail: str
    advice: str | None = None


def ok(detail: str) -> CheckResult:
    return CheckResult(State.ok, detail)


def warn(detail: str, advice: str) -> CheckResult:
    return CheckResult(State.warning, detail, advice)


def failed(detail: str, advice: str) -> CheckResult:
    return CheckResult(State.failed, detail, advice)
