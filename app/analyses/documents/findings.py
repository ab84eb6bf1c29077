"""What an analysis found, and its document: what all analyses say of themselves is added here, and nowhere else."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from core import Advisory
from core.session import ExcludedMeasurement, SessionData


@dataclass(frozen=True, slots=True)
class Findings:
    """The fields of one analysis alone, the measurements that do not count in it, and what to know of it."""

    fields: Mapping[str, Any]
    excluded: Iterable[ExcludedMeasurement]
    warnings: Iterable[Advisory]


def findings_document(head: Mapping[str, Any], findings: Findings, data: SessionData) -> dict[str, Any]:
    """Return the document of an analysis; `head` names its subject, its inputs and the program."""
    return {
        **head,
        **findings.fields,
        "excluded": ExcludedList(data).documents(findings.excluded),
        "warnings": advisories(findings.warnings),
    }


class ExcludedList:
    """The measurements of a session by their places, to list those that do not count."""

    def __init__(self, data: SessionData) -> None:
        known = [(image.measurement_id, image.filename) for image in data.images]
        self._of_images = {name for name, _ in known}
        known += [(pose.measurement_id, None) for pose in data.measured]
        self._places = {name: (place, filename) for place, (name, filename) in enumerate(known)}

    def documents(self, excluded: Iterable[ExcludedMeasurement]) -> list[dict[str, Any]]:
        """Return each measurement once, in the session's order, with the first reason given."""
        reasons: dict[str, ExcludedMeasurement] = {}
        for one in excluded:
            reasons.setdefault(one.measurement_id, one)
        return [
            {
                "measurement_id": name if name in self._of_images else None,
                "measured_pose_id": None if name in self._of_images else name,
                "filename": self._places[name][1],
                "code": reasons[name].code,
                "detail": reasons[name].detail,
            }
            for name in sorted(reasons, key=lambda name: self._places[name][0])
        ]


def advisories(warnings: Iterable[Advisory]) -> list[dict[str, Any]]:
    """Return warnings, each once, in their order."""
    return [{"code": w.code, "detail": w.detail, "advice": w.advice} for w in dict.fromkeys(warnings)]
