"""Result of one check of an installation."""

from __future__ import annotations

import enum
import errno
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy.exc import DBAPIError

from app.errors import ServiceError


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


def unusable(error: OSError, place: Path) -> CheckResult:
    """Say which file or folder the system refused; `place` where the error names none."""
    path = error.filename or place
    if error.errno == errno.EROFS:
        return failed(
            f"{path} is on a read-only disk", "`dmesg` has the reason; copy what is there off that disk."
        )
    return failed(
        f"{path} cannot be used: {error.strerror or error}",
        f"Give it to the user that the service runs as: chown -R USER {path}. Check that its disk is mounted.",
    )


def guarded(results: Iterator[CheckResult], place: Path) -> list[CheckResult]:
    """Return what a check of `place` found; what it may not read, and a database, end it as a failure of its own."""
    found: list[CheckResult] = []
    try:
        found.extend(results)
    except OSError as error:
        found.append(unusable(error, place))
    except (ServiceError, DBAPIError):
        found.append(failed("not checked: the database cannot be used", "See the checks of the database."))
    return found
