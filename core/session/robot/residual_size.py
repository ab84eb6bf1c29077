"""The warning of residuals that are larger than robots scatter: the data, not the robot, are then to be looked at.

Industrial arms are off their identified chain by some hundredths of a percent of where they reach: a FANUC R-2000iC by
.16 mm at 3.2 m, a UR10, whose gears no chain describes, by .44 mm at 1.5 m, .03 %. An instrument that moved half-way by
1 mm and .05°, or joint angles that are read with .05° of noise, leave .045 to .1 % on arms of 1.5 to 3 m.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from core.errors import MAX_LISTED, Advisory, listed
from core.kinematics import Identification, PoseData
from core.session.robot.result import RobotIdentification

MAX_OF_REACH = 4e-4
"""Of the distance of the farthest measured point from the robot's base."""
MAX_OF_NOISE = 2.0
"""Of the instrument's stated noise: residuals within it are the instrument's."""
MAX_UNSTATED_MM = 0.5
"""Where no noise is stated: cameras of other makers before their targets have as much (tests/reference)."""
_LENGTH = 3  # coordinates of a position


def residual_warnings(
    found: RobotIdentification, poses: PoseData, farthest: Sequence[str] = ()
) -> Iterator[Advisory]:
    """Yield the warning `residuals_large`; `farthest` are the poses that are off most, for its advice."""
    reach, off = _reach_mm(found, poses), found.residual.position_rms_mm
    if off <= max(MAX_OF_REACH * reach, _instrument_mm(poses)):
        return
    most = f", and those that are off most: {listed(farthest)}" if farthest else ""
    yield Advisory(
        "residuals_large",
        f"The poses are off the identified arm by {off:.3g} mm (rms), {100.0 * off / reach:.2g} % of its reach of "
        f"{reach:.0f} mm: robots scatter by less.",
        "Check that each pose has its own joint angles, in their order; that neither instrument nor target was moved "
        f"on the way; whether joints are coupled (joint_coupling); and the poses for gross errors{most}.",
    )


def farthest(found: Identification, poses: PoseData) -> list[str]:
    """Return the labels of the poses that are farthest off the arm among those that count, the farthest first."""
    rows = np.flatnonzero(found.used)
    off = np.linalg.norm(found.residuals[:_LENGTH, rows], axis=0)
    return [poses.label(int(rows[i])) for i in np.argsort(-off, kind="stable")[:MAX_LISTED]]


def _reach_mm(found: RobotIdentification, poses: PoseData) -> float:
    """Return how far the farthest measured point is from the base."""
    T = np.linalg.inv(found.T_target_base)[poses.targets]
    in_base = np.einsum("nij,nj->ni", T[:, :3, :3], poses.positions_mm) + T[:, :3, 3]
    return float(np.max(np.linalg.norm(in_base, axis=1)))


def _instrument_mm(poses: PoseData) -> float:
    if poses.covariance is None:
        return MAX_UNSTATED_MM
    variances = np.diagonal(poses.covariance, axis1=1, axis2=2)[:, :_LENGTH]
    return MAX_OF_NOISE * float(np.sqrt(np.median(variances.sum(axis=1))))
