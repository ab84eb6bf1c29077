"""Commanded poses, and the visits of one pose or of several, as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from core.errors import Advisory
from core.geometry import so3_log, transform
from core.metrology import PoseAccuracy
from core.session.model import CommandedPose, MeasuredPose

SAME_ORIENTATION = 1e-5
"""Commanded orientations nearer to one another than this, rad, are one."""

Visits = Mapping[str, Sequence[MeasuredPose]]
Commands = Mapping[str, CommandedPose]
Compared = tuple[dict[str, PoseAccuracy], tuple[Advisory, ...]]
"""AP by pose, and what to know of it."""


def oriented(visits: Sequence[MeasuredPose]) -> bool:
    """Return whether every visit of a pose has an orientation."""
    return all(visit.rotation is not None for visit in visits)


def one_orientation(commands: Commands, within: float = SAME_ORIENTATION) -> bool:
    """Return whether all poses were commanded with one and the same orientation, `within` so many rad."""
    rotations = [R for c in commands.values() if (R := c.rotation()) is not None]
    if len(rotations) < len(commands):
        return False
    return all(float(np.linalg.norm(so3_log(R @ rotations[0].T))) <= within for R in rotations)


def commanded_pose(commanded: CommandedPose) -> Float[np.ndarray, "4 4"]:
    """Return T_base_flange as commanded; unturned where the orientation is not known."""
    rotation = commanded.rotation()
    return transform(np.eye(3) if rotation is None else rotation, commanded_position(commanded))


def commanded_position(commanded: CommandedPose) -> Float[np.ndarray, "3"]:
    """Return the commanded position, mm, which is known."""
    return np.array(commanded.position_mm, dtype=np.float64)


def transforms_of(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "n 4 4"]:
    """Return the visits that have an orientation as transforms."""
    return np.array([transform(v.rotation, v.position_mm) for v in visits if v.rotation is not None])


def mean_common(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "6 e"] | None:
    """Return what the errors that all images share do to the mean; None where a visit does not have it."""
    common = [visit.common for visit in visits if visit.common is not None]
    return np.mean(common, axis=0) if len(common) == len(visits) else None


def mean_position(visits: Sequence[MeasuredPose]) -> Float[np.ndarray, "3"]:
    """Return the mean of the visits' positions, mm."""
    return np.asarray(np.mean([visit.position_mm for visit in visits], axis=0))
