"""The base of every failure of the numerics, warnings that accompany a result, and lists in messages."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(frozen=True, slots=True)
class Advisory:
    """A warning that accompanies a result: a stable code, what was observed, and what to do about it."""

    code: str
    detail: str
    advice: str | None = None


ADVISED_TILT = "30° to 45°"
"""Of a flat target against the image plane: of views at 20° about half determine the focal length (docs/limits.md)."""
MAX_LISTED = 5  # labels in a message; of more it gives the number of the others


def listed(labels: Iterable[str]) -> str:
    """Return labels for a message: "P1, P2, P3, P4, P5 and 7 more"."""
    several = list(labels)
    more = f" and {len(several) - MAX_LISTED} more" if len(several) > MAX_LISTED else ""
    return ", ".join(several[:MAX_LISTED]) + more


class GridposeError(Exception):
    """Base of every failure the numerics raise on purpose."""

    code: ClassVar[str] = "gridpose_error"
    default_advice: ClassVar[str | None] = None

    def __init__(self, detail: str, advice: str | None = None, *, points: Any = None) -> None:
        super().__init__(detail)
        self.detail = detail
        self.advice = advice if advice is not None else self.default_advice
        self.points = points
        """The `core.targets.GridPoints` found before the failure, or None: they still serve pooled estimates."""
