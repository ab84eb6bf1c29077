"""A map of predicted repeatability over the workspace, and the worst place in it.

The workspace is sampled in joint space, between limits, by a Halton sequence. Each sample's place is its distance from
the first axis and its height along it, in which an arm's workspace is the same all around; a cell of the map holds the
best, the median and the worst RP_l of the configurations that reach it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument
from core.kinematics import ArmState, JointNoise, forward
from core.session.joint_noise.prediction import PredictedScatter, predict_scatter

SAMPLES = 6000
CELLS_ACROSS = 32
MIN_SAMPLES_IN_CELL = 3


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
    if np.any(limits[0] > limits[1]):
        raise InvalidArgument("A joint's lower limit is above its upper one.")
    # Takes half a second to load, which every process of a service would pay.
    from scipy.stats import qmc

    unit = qmc.Halton(limits.shape[1], scramble=False).random(samples)
    q = limits[0] + unit * (limits[1] - limits[0])
    found = predict_scatter(noise, arm, q)
    at = (forward(arm.chain, q) @ arm.T_flange_camera)[:, :3, 3]
    radius, height = np.hypot(at[:, 0], at[:, 1]), at[:, 2]
    size = _round_size(max(float(radius.max()), float(np.ptp(height)) / 2.0) / (CELLS_ACROSS / 2.0))
    column, row = np.floor(radius / size).astype(np.intp), np.floor(height / size).astype(np.intp)
    places, which = np.unique(np.stack([column, row], axis=1), axis=0, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(which.ravel()))
    cells = []
    for (i, j), members in zip(places.tolist(), np.split(found.rp_l_mm[order], ends[:-1]), strict=True):
        if len(members) >= MIN_SAMPLES_IN_CELL:
            low, middle, high = (float(x) for x in (members.min(), np.median(members), members.max()))
            cells.append(MapCell((i + 0.5) * size, (j + 0.5) * size, len(members), low, middle, high))
    worst = int(np.argmax(found.rp_l_mm))
    return RepeatabilityMap(
        tuple(cells), size, samples, q[worst], at[worst], predict_scatter(noise, arm, q[worst : worst + 1])
    )


def _round_size(size: float) -> float:
    """Return the next of 1, 2, 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(max(size, 1e-6)))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= size * (1.0 - 1e-9)))
