"""Whether measured and commanded poses are in one unit: by the size of what they span.

Distances need no common frame. An instrument's point is not the commanded one, so that distances differ where the robot
turns between poses, but not a thousandfold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.session.model import CommandedPose, MeasuredPose

METRES = 1e-3
INCHES = 1.0 / 25.4
FACTOR = 3.3
"""A scale within it of a thousand or a thousandth is one of units, not of a tool's offset."""
INCH_FACTOR = 1.1
MAX_METRES = 100.0
"""No instrument is as far from the robot, m: larger numbers are no metres."""
MAX_SCATTER_SHARE = 0.01
"""Of the span of the poses: what scatters more was read about local origins, pose by pose."""
MIN_COMMANDED_MM = 0.05
"""Commanded poses that span less are one place."""


@dataclass(frozen=True, slots=True)
class UnitContradiction:
    """The scale of measured to commanded distances between poses, and the units that would explain it, in words."""

    scale: float
    guess: str


def contradicted_unit(
    visits: Mapping[str, Sequence[MeasuredPose]], commanded: Mapping[str, CommandedPose]
) -> UnitContradiction | None:
    """Return by what scale measured and commanded distances between poses contradict one another; None if they do not.

    Poses of different frames do not compare.
    """
    frames: dict[int, list[tuple[Float[np.ndarray, "n 3"], Sequence[float]]]] = {}
    for pose_id, of_pose in visits.items():
        command = commanded.get(pose_id)
        if of_pose and command is not None and command.position_mm is not None:
            positions = np.array([visit.position_mm for visit in of_pose])
            frames.setdefault(of_pose[0].frame, []).append((positions, command.position_mm))
    for pairs in frames.values():
        found = _contradiction(
            [positions for positions, _ in pairs],
            np.array([command for _, command in pairs], dtype=np.float64),
        )
        if found is not None:
            return found
    return None


def _contradiction(
    visits: Sequence[Float[np.ndarray, "_ 3"]], commanded: Float[np.ndarray, "n 3"]
) -> UnitContradiction | None:
    measured = np.array([positions.mean(axis=0) for positions in visits])
    squares = sum(float(np.sum((p - m) ** 2)) for p, m in zip(visits, measured, strict=True))
    scatter = np.sqrt(squares / max(sum(map(len, visits)) - len(visits), 1))
    spans = [
        float(np.sqrt(np.mean(np.sum((x - x.mean(axis=0)) ** 2, axis=1)))) for x in (measured, commanded)
    ]
    if spans[1] < MIN_COMMANDED_MM or scatter > MAX_SCATTER_SHARE * spans[0]:
        return None
    scale = spans[0] / spans[1]
    if _near(scale, METRES, FACTOR) and float(np.abs(measured).max()) < MAX_METRES:
        return UnitContradiction(scale, "the measured poses are in metres")
    if _near(scale, INCHES, INCH_FACTOR) and len(measured) > 2:
        return UnitContradiction(scale, "the measured poses are in inches")
    if _near(scale, 1.0 / METRES, FACTOR):
        return UnitContradiction(
            scale, "the commanded poses are in metres, or the measured ones in micrometres"
        )
    return None


def _near(scale: float, unit: float, factor: float) -> bool:
    return unit / factor < scale < unit * factor
