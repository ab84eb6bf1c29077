"""The figures of a pose under one set of names.

ISO 9283:1998 defines those of the position as a whole (AP_p 7.2.1, RP_l 7.2.2, vAP_p 7.2.3) and of the angles (RP_a,
RP_b, RP_c and so on, ibidem); those along the axes stand beside them, by the angles' formula.
"""

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
