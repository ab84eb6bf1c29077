"""Pose accuracy AP of one pose (ISO 9283:1998, 7.2.1), with intervals, from what the robot was off there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.geometry import is_near_gimbal_lock, rotation_to_rpy, rpy_jacobian, so3_exp
from core.metrology.accuracy.deviation_parts import DeviationParts
from core.metrology.accuracy.deviations import EstimatedDeviation
from core.metrology.iso9283 import pose_accuracy
from core.metrology.pose_cycles import PerComponent


@dataclass(frozen=True, slots=True)
class CommandedPoint:
    """Where the commanded point is by what is measured: R (p + R_measured offset), up to one shift of all places.

    `R_base_measured` turns from the frame of the measured poses to the base, `offset_mm` is the point in the frame of
    the camera or probe; zero where it is not known, or the poses' own turns do not count.
    """

    R_base_measured: Float[np.ndarray, "3 3"]
    offset_mm: Float[np.ndarray, "3"]

    def attained(
        self, positions_mm: Float[np.ndarray, "n 3"], rotations: Float[np.ndarray, "n 3 3"] | None
    ) -> Float[np.ndarray, "n 3"]:
        """Return the point in the base frame, up to the shift, mm."""
        inside = positions_mm if rotations is None else positions_mm + rotations @ self.offset_mm
        return np.asarray(inside @ self.R_base_measured.T)


@dataclass(frozen=True, slots=True)
class PoseAccuracy:
    """AP of one pose, mm and rad.

    `figures` are the studentised best-fit ones, `interval` theirs, `held_out` those with the frames tied by all other
    poses. `rotation` is the deviation of orientation as a rotation vector in the base frame; where `near_singularity`,
    within 5° of pitch = ±90°, it alone is given and the angles, which mean nothing there, are None.
    `held_out_interval` is that of the position, in these frames; None where they leave no degree of freedom.
    `degrees_of_freedom` are those of the positions' tie, `parts` what leaves the position's deviation open, `place` the
    frames it was compared in.
    """

    figures: PerComponent[float | None]
    interval: PerComponent[tuple[float, float] | None]
    held_out: PerComponent[float | None]
    rotation: Float[np.ndarray, "3"] | None
    near_singularity: bool
    degrees_of_freedom: float
    parts: DeviationParts | None = None
    place: CommandedPoint | None = None
    held_out_interval: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class HeldOutDeviation:
    """Attained - commanded with the frames tied by the other poses: position (mm), rotation vector (rad) or None."""

    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3"] | None = None


def tied_accuracy(
    position: EstimatedDeviation,
    rotation: EstimatedDeviation | None,
    commanded_rotation: Float[np.ndarray, "3 3"] | None,
    held_out: HeldOutDeviation | None,
    degrees_of_freedom: float,
    place: CommandedPoint | None = None,
) -> PoseAccuracy | None:
    """Return AP of one pose from what the robot was off there; None where its position is not determined."""
    if position.vector is None:
        return None
    singular = commanded_rotation is not None and is_near_gimbal_lock(
        float(rotation_to_rpy(commanded_rotation)[1])
    )
    turned = rotation.vector if rotation is not None else None
    angles = None if singular else commanded_rotation
    figures = _figures(position.vector, turned, angles)
    intervals: list[tuple[float, float] | None] = [position.length_interval]
    intervals += _intervals(position.residual, position.half_widths(np.eye(3)))
    if rotation is None or turned is None or angles is None:
        intervals += [None] * 3
    else:
        J = rpy_jacobian(rotation_to_rpy(angles))
        intervals += _intervals(J @ rotation.residual, rotation.half_widths(J))
    return PoseAccuracy(
        figures,
        PerComponent(
            *(
                _with(interval, figure)
                for interval, (_, figure) in zip(intervals, figures.items(), strict=True)
            )
        ),
        PerComponent(*[None] * len(intervals))
        if held_out is None
        else _figures(held_out.position_mm, held_out.rotation, angles),
        turned,
        singular and turned is not None,
        degrees_of_freedom,
        position.parts,
        place,
        position.held_out_interval,
    )


def _figures(
    position: Float[np.ndarray, "3"],
    turn: Float[np.ndarray, "3"] | None,
    commanded: Float[np.ndarray, "3 3"] | None,
) -> PerComponent[float | None]:
    if turn is None or commanded is None:
        return pose_accuracy(position, np.zeros(3))
    return pose_accuracy(position, np.zeros(3), so3_exp(turn) @ commanded, commanded)


def _with(interval: tuple[float, float] | None, figure: float | None) -> tuple[float, float] | None:
    """Return the interval extended to the studentised figure, which is seldom outside of what is known."""
    if interval is None or figure is None:
        return interval
    return min(interval[0], figure), max(interval[1], figure)


def _intervals(
    centre: Float[np.ndarray, "3"], half: Float[np.ndarray, "3"] | None
) -> list[tuple[float, float] | None]:
    if half is None:
        return [None] * 3
    return [(float(a - b), float(a + b)) for a, b in zip(centre, half, strict=True)]
