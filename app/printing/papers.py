"""Papers, and what of them is free for a target."""

from __future__ import annotations

from dataclasses import dataclass

SIZES_MM = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
}
"""Width and height upright (ISO 216), smallest first."""


@dataclass(frozen=True, slots=True)
class Paper:
    """A sheet of paper as it lies: upright, or on its long side."""

    name: str
    upright: bool

    @property
    def width_mm(self) -> float:
        return SIZES_MM[self.name][0 if self.upright else 1]

    @property
    def height_mm(self) -> float:
        return SIZES_MM[self.name][1 if self.upright else 0]

    def __str__(self) -> str:
        return f"{self.name} {'portrait' if self.upright else 'landscape'}"
