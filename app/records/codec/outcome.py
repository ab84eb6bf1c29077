"""What a job brings back of an image: columns of a `results` row, and the failure, if one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Failure:
    """Why an image gave no calibration."""

    code: str
    detail: str
    advice: str | None


@dataclass(frozen=True, slots=True)
class DetectedTarget:
    """A target that an image was searched for and shows: the columns of its `results` row, and the failure, if one.

    `duration_ms` is what it alone took, without decoding and searching.
    """

    target_id: str
    result: dict[str, Any]
    failure: Failure | None
    duration_ms: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a job brings back: the columns of its `results` row, if any, and the failure, if one.

    Of an image that was searched for several targets these are what holds where the row's own is not among those
    `shown`, which are in the session's order.
    """

    result: dict[str, Any] | None
    failure: Failure | None
    shown: tuple[DetectedTarget, ...] = ()


@dataclass(frozen=True, slots=True)
class Provenance:
    """What a result was computed from and with: enough to compute it again."""

    core_version: str
    input_sha256: str
    settings: dict[str, Any]

    def columns(self) -> dict[str, Any]:
        """Return the columns of the `results` row."""
        return {
            "core_version": self.core_version,
            "input_sha256": self.input_sha256,
            "settings": self.settings,
        }
