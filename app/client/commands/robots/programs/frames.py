"""Rigid transforms in plain Python, and the frames in which a program's points are stated."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ...rotations import (
    Matrix,
    Vector,
    applied,
    from_roll_pitch_yaw,
    identity,
    product,
    transposed,
)

_PARTS = 6


@dataclass(frozen=True, slots=True)
class Frame:
    """T_a_b: the rotation and the position (mm) of frame b in frame a."""

    rotation: Matrix = field(default_factory=identity)
    position_mm: Vector = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def __matmul__(self, other: Frame) -> Frame:
        """Return T_a_c of T_a_b and T_b_c."""
        turned = applied(self.rotation, other.position_mm)
        position = [a + b for a, b in zip(self.position_mm, turned, strict=True)]
        return Frame(product(self.rotation, other.rotation), position)

    def inverse(self) -> Frame:
        """Return T_b_a."""
        back = transposed(self.rotation)
        return Frame(back, [-value for value in applied(back, self.position_mm)])


def parse_frame(text: str) -> Frame:
    """Return the frame of `x,y,z,roll,pitch,yaw` in mm and degrees. Raises ValueError."""
    numbers = [float(part) for part in text.split(",")]
    if len(numbers) != _PARTS or not all(map(math.isfinite, numbers)):
        raise ValueError("a frame has six numbers")
    return Frame(from_roll_pitch_yaw(*map(math.radians, numbers[3:])), numbers[:3])
