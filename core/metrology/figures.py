"""The seven figures that ISO 9283 gives of a pose, under one set of names."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Figures(Generic[T]):
    """One value for the position as a whole, one an axis, one a rotation angle; mm and rad."""

    position_mm: T
    x_mm: T
    y_mm: T
    z_mm: T
    roll: T
    pitch: T
    yaw: T

    def items(self) -> list[tuple[str, T]]:
        """Return (name, value), in the order above."""
        return [(field.name, getattr(self, field.name)) for field in fields(self)]


FIGURE_NAMES = tuple(field.name for field in fields(Figures))
