"""Where in the workspace the robot is off, and by how much: the identified arm against the nominal one.

    d(q) = attained(q) - meant(q)

`attained` is the position that the identified arm has by its model, `meant` that of the nominal chain at the base and
tool which suit the measured poses best: an error that another base or tool removes does not count. The
uncertainty of |d| is that of the identified arm's prediction along d, times the growth that held-out poses ask for;
neither holds the scatter of a visit.

The region is the box of joint space that the measured poses span. Cells that configurations of the region reach have
their figures alone; all others are reached by extrapolation only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.kinematics.arm_model import ArmState
from core.kinematics.correction.model import attained_poses, poses_of
from core.kinematics.error_model import ErrorModel
from core.kinematics.workspace import (
    MIN_SAMPLES_IN_CELL,
    cell_size,
    cells_of,
    positions_in_base,
    sample_workspace,
)

SAMPLES = 3000
"""Within the region, and as many between the limits."""


@dataclass(frozen=True, slots=True)
class KinematicError:
    """At joint angles: the difference of position (mm, axes of the measuring frame), its length and the standard
    uncertainty of that.
    """

    difference_mm: Float[np.ndarray, "n 3"]
    length_mm: Float[np.ndarray, " n"]
    standard_uncertainty_mm: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class ErrorCell:
    """A cell by its middle: distance from the first axis and height, mm; the error of configurations that reach it, mm.

    `measured` poses lie in it. `extrapolated`: no configuration of the region reaches it.
    """

    radius_mm: float
    height_mm: float
    configurations: int
    measured: int
    extrapolated: bool
    median_mm: float
    largest_mm: float
    median_uncertainty_mm: float


@dataclass(frozen=True, slots=True)
class KinematicErrorMap:
    """Cells of one size, and the error over the region: its median and where it is largest, with joint angles (rad),
    position of the measured point and difference in the base frame (mm), and the error there.
    """

    cells: tuple[ErrorCell, ...]
    cell_mm: float
    samples: int
    measured: int
    median_mm: float
    median_uncertainty_mm: float
    worst_joint_angles: Float[np.ndarray, " j"]
    worst_position_mm: Float[np.ndarray, "3"]
    worst_difference_mm: Float[np.ndarray, "3"]
    worst: KinematicError


def kinematic_error(
    model: ErrorModel, nominal: ArmState, joint_angles: Float[np.ndarray, "n j"]
) -> KinematicError:
    """Return the error of the nominal arm at joint angles (rad), before the first target."""
    attained = attained_poses(model, model.level, joint_angles)[:, :3, 3]
    d = attained - poses_of(nominal, joint_angles)[:, :3, 3]
    length = np.linalg.norm(d, axis=1)
    along = d / np.maximum(length, 1e-12)[:, None]
    variance = np.empty(len(d))
    asked = model.fit.design.at(joint_angles, components=3)
    for some in asked.blocks(np.arange(len(d))):
        toward = np.einsum("pmn,nm->pn", asked.rows(some), along[some])
        variance[some] = np.sum(toward * (model.fitted.covariance @ toward), axis=0)
    return KinematicError(d, length, float(model.growth[0]) * np.sqrt(np.maximum(variance, 0.0)))


def map_kinematic_error(
    model: ErrorModel, nominal: ArmState, limits: Float[np.ndarray, "2 j"], *, samples: int = SAMPLES
) -> KinematicErrorMap:
    """Map the error of the nominal arm between joint limits (rad).

    Raises InvalidArgument where a lower limit is above the upper one.
    """
    problem = model.fit.design
    seen = problem.seen.joint_angles[model.fit.used]
    region = np.stack([seen.min(axis=0), seen.max(axis=0)])
    within = np.concatenate([seen, sample_workspace(region, samples)])
    q = within
    between = sample_workspace(limits, samples)
    if np.any(limits[0] < region[0]) or np.any(limits[1] > region[1]):
        q = np.concatenate([within, between])
    error = kinematic_error(model, nominal, q)
    at = positions_in_base(problem.arm, q)
    size = cell_size(at)
    cells = []
    for cell in cells_of(at, size):
        inside = cell.members[cell.members < len(within)]
        measured = int(np.sum(inside < len(seen)))
        extrapolated = not measured and len(inside) < MIN_SAMPLES_IN_CELL
        members = cell.members if extrapolated else inside
        if measured or len(members) >= MIN_SAMPLES_IN_CELL:
            lengths = error.length_mm[members]
            cells.append(
                ErrorCell(
                    cell.radius_mm,
                    cell.height_mm,
                    len(members),
                    measured,
                    extrapolated,
                    float(np.median(lengths)),
                    float(lengths.max()),
                    float(np.median(error.standard_uncertainty_mm[members])),
                )
            )
    worst = int(np.argmax(error.length_mm[: len(within)]))
    there = kinematic_error(model, nominal, q[worst : worst + 1])
    return KinematicErrorMap(
        tuple(cells),
        size,
        len(q) - len(seen),
        len(seen),
        float(np.median(error.length_mm[: len(within)])),
        float(np.median(error.standard_uncertainty_mm[: len(within)])),
        q[worst],
        at[worst],
        problem.arm.T_target_base[0, :3, :3].T @ there.difference_mm[0],
        there,
    )
