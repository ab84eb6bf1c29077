"""A job as it travels between processes. This module loads no database: a worker process does without."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from app.records.outcome import Outcome


@dataclass(frozen=True, slots=True)
class TargetQuery:
    """A target that an image is searched for; `fields` are those of `core.TargetSpec`."""

    target_id: str
    fields: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Job:
    """All a worker needs to measure one image; plain values, so that it travels between processes.

    `claim` is the token of this one hand-out: a result is taken only from whoever holds the row's latest. `target_id`
    is the row's own target, None until one was found; `targets` are those to look for, where several are, in the
    session's order.
    """

    measurement_id: str
    claim: str
    sha256: str
    target_id: str | None
    targets: tuple[TargetQuery, ...]
    lens: dict[str, float] | None
    intrinsics: dict[str, float] | None

    @property
    def has_explicit_target(self) -> bool:
        """Whether the one target to look for is the row's own, so that whatever comes of it is the row's."""
        return [sought.target_id for sought in self.targets] == [self.target_id]


@dataclass(frozen=True, slots=True)
class JobResult:
    """What came of a job that ran to its end, in success or in a failure with a code."""

    job: Job
    outcome: Outcome
    duration_ms: float
