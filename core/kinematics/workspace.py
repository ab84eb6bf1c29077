"""An arm's workspace: configurations sampled between joint limits, and the cells of a map of it.

Joint space is sampled by a Halton sequence. A configuration's place is the distance of the measured point from the
first axis and its height along it, in which an arm's workspace is the same all around.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.errors import InvalidArgument
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import forward

CELLS_ACROSS = 32
MIN_SAMPLES_IN_CELL = 3


@dataclass(frozen=True, slots=True)
class WorkspaceCell:
    """A cell by its middle, mm, and the configurations in it, by their index."""

    radius_mm: float
    height_mm: float
    members: Int[np.ndarray, " k"]


def sample_workspace(limits: Float[np.ndarray, "2 j"], samples: int) -> Float[np.ndarray, "n j"]:
    """Return configurations between joint limits (rad).

    Raises InvalidArgument where a lower limit is above the upper one.
    """
    if np.any(limits[0] > limits[1]):
        raise InvalidArgument("A joint's lower limit is above its upper one.")
    # Takes half a second to load, which every process of a service would pay.
    from scipy.stats import qmc

    unit = qmc.Halton(limits.shape[1], scramble=False).random(samples)
    return np.asarray(limits[0] + unit * (limits[1] - limits[0]))


def positions_in_base(arm: ArmState, joint_angles: Float[np.ndarray, "n j"]) -> Float[np.ndarray, "n 3"]:
    """Return where the measured point is in the robot's base frame, mm."""
    return (forward(arm.chain, joint_angles) @ arm.T_flange_camera)[:, :3, 3]


def cell_size(positions_mm: Float[np.ndarray, "n 3"]) -> float:
    """Return the width and height of cells that divide these places well: 1, 2 or 5 times a power of ten, mm."""
    across = float(np.hypot(positions_mm[:, 0], positions_mm[:, 1]).max())
    size = max(across, float(np.ptp(positions_mm[:, 2])) / 2.0) / (CELLS_ACROSS / 2.0)
    power = 10.0 ** np.floor(np.log10(max(size, 1e-6)))
    return float(next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= size * (1.0 - 1e-9)))


def cells_of(positions_mm: Float[np.ndarray, "n 3"], size_mm: float) -> Iterator[WorkspaceCell]:
    """Yield the cells that places in the base frame lie in, with the indices of those."""
    radius = np.hypot(positions_mm[:, 0], positions_mm[:, 1])
    places = np.floor(np.stack([radius, positions_mm[:, 2]], axis=1) / size_mm).astype(np.intp)
    found, which = np.unique(places, axis=0, return_inverse=True)
    order = np.argsort(which.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(which.ravel()))
    for (i, j), members in zip(found.tolist(), np.split(order, ends[:-1]), strict=True):
        yield WorkspaceCell((i + 0.5) * size_mm, (j + 0.5) * size_mm, members)
