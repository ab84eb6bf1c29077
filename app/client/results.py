"""Results as values: measurements, and analyses with their tables as rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from .http import Json
from .summary import is_measured

_TABLES = {
    "repeatability": "poses",
    "camera-poses": "camera_poses",
    "hand-eye": "residuals",
    "dh": "joints",
    "intrinsics": "groups",
    "comparison": "repeatabilities",
}
"""The list of an analysis that is its table."""


@dataclass(frozen=True, slots=True)
class Measurement:
    """One image and what came of it; `document` is the service's whole answer.

    `measured` includes images whose points were found and whose pose comes from the session's camera.
    """

    id: str
    pose_id: str
    cycle: int | None
    burst: int | None
    filename: str | None
    status: str
    measured: bool
    failure_code: str | None
    advice: str | None
    document: Json

    @classmethod
    def of(cls, document: Json) -> Measurement:
        """Return the value of a service's answer."""
        failure = document["failure"] or {}
        return cls(
            id=document["id"],
            pose_id=document["pose_id"],
            cycle=document["cycle"],
            burst=document["burst"],
            filename=document["filename"],
            status=document["status"],
            measured=is_measured(document),
            failure_code=failure.get("code"),
            advice=failure.get("advice"),
            document=document,
        )


@dataclass(frozen=True, slots=True)
class Analysis:
    """An analysis of a session; `document` is the service's whole answer."""

    kind: str
    document: Json

    @property
    def rows(self) -> list[dict[str, Any]]:
        """The table: one flat mapping for each pose, image or joint, keys of nested values joined by a dot."""
        return [dict(_flat(row)) for row in self.document[_TABLES[self.kind]]]

    @property
    def warnings(self) -> list[str]:
        """What to know of the figures, each in a sentence."""
        return [f"{w['detail']} ({w['code']})" for w in self.document.get("warnings", [])]


def _flat(row: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in row.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
