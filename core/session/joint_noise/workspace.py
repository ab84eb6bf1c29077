"""A map of predicted repeatability over the workspace, and the worst place in it.

A cell of the map holds the best, the median and the worst RP_l of the configurations that reach it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.kinematics import (
    MIN_SAMPLES_IN_CELL,
    ArmState,
    JointNoise,
    cell_size,
    cells_of,
    positions_in_base,
    sample_workspace,
)
from core.session.joint_noise.prediction import PredictedScatter, predict_scatter

SAMPLES = 6000


@dataclass(frozen=True, slots=True)
class MapCell:
    """A cell by its middle: distance from the first axis and height, mm; RP_l of configurations that reach it, mm."""

    radius_mm: float
    height_mm: float
    configurations: int
    least_rp_l_mm: float
    median_rp_l_mm: float
    largest_rp_l_mm: float


@dataclass(frozen=True, slots=True)
class RepeatabilityMap:
    """Cells of one size over the workspace, and where RP_l is largest: its joint angles (rad), the position of the
    measured point in the base frame (mm), and what is predicted there.
    """

    cells: tuple[MapCell, ...]
    cell_mm: float
    samples: int
    worst_joint_angles: Float[np.ndarray, " j"]
    worst_position_mm: Float[np.ndarray, "3"]
    worst: PredictedScatter


def map_repeatability(
    noise: JointNoise,
    arm: ArmState,
    limits: Float[np.ndarray, "2 j"],
    *,
    samples: int = SAMPLES,
) -> RepeatabilityMap:
    """Map RP_l of the measured point between joint limits (rad).

    Raises InvalidArgument where a lower limit is above the upper one.
    """
    q = sample_workspace(limits, samples)
    found = predict_scatter(noise, arm, q)
    at = positions_in_base(arm, q)
    size = cell_size(at)
    cells = []
    for cell in cells_of(at, size):
        if len(cell.members) >= MIN_SAMPLES_IN_CELL:
            rp = found.rp_l_mm[cell.members]
            low, middle, high = (float(x) for x in (rp.min(), np.median(rp), rp.max()))
            cells.append(MapCell(cell.radius_mm, cell.height_mm, len(rp), low, middle, high))
    worst = int(np.argmax(found.rp_l_mm))
    return RepeatabilityMap(
        tuple(cells), size, samples, q[worst], at[worst], predict_scatter(noise, arm, q[worst : worst + 1])
    )
