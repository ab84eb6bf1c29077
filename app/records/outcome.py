"""What a job brings back of an image: columns of a `results` row, documents of which may be text, and the failure."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any, Self


@dataclass(frozen=True, slots=True)
class EncodedJson:
    """A JSON document as text, which a JSON column takes in place of the document: another process encoded it."""

    text: str

    @classmethod
    def of(cls, document: Any) -> Self:
        """Return a document as text, as a column would write it."""
        return cls(json.dumps(document))


def write_json(document: Any) -> str:
    """Return what a JSON column stores of a document, or of one that is text already."""
    return document.text if isinstance(document, EncodedJson) else json.dumps(document)


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

    def encoded(self) -> Outcome:
        """Return the same with every document of a result as JSON text."""
        shown = tuple(replace(target, result=_encoded(target.result)) for target in self.shown)
        return Outcome(_encoded(self.result) if self.result is not None else None, self.failure, shown)


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


def _encoded(columns: dict[str, Any]) -> dict[str, Any]:
    return {
        name: EncodedJson.of(value) if isinstance(value, (dict, list)) else value
        for name, value in columns.items()
    }
