"""What an overlay is of, as values that pass between processes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class OverlaySubject:
    """A measurement as the API shows it, its points, and its target.

    `kind` and `pitch_mm` are those of the target, None where there is no target.
    """

    measurement: dict[str, Any]
    points: list[dict[str, Any]] | None
    kind: str | None
    pitch_mm: float | None
