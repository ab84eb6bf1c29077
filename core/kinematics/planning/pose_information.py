"""What poses say of an arm's parameters, those taken so far and each of many that could be next.

With J the derivatives of pose i by the parameters that are free and by the errors that all poses share, and
V_i = C_i + S, the pose says J_iᵀ V_i⁻¹ J_i of both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.kinematics.arm_model import ArmState
from core.kinematics.dh import JOINT_PARAMETERS, Chain
from core.kinematics.global_fit import (
    Observations,
    fix_gauge,
    information_of,
    linearised,
    observations_of,
    whitened,
    whitener,
)
from core.kinematics.pose_observations import PoseData
from core.numerics import SMALLEST, Variances

OPEN_SHARE = 0.02
"""Of the arm's reach: the standard uncertainty of a parameter, as the arm's end sees it, of which the poses so far say
nothing. It is that from which on an identification holds a parameter as not determined."""


@dataclass(frozen=True, slots=True)
class ArmInformation:
    """Information on the parameters of chain, tool and bases that all poses together determine, then on the shared
    errors, f in all.

    `measured` is that of the poses so far, `candidates` that of each candidate. `lengths` and `angles` mark the chain's
    parameters (mm, rad), `reach_mm` is where an angle is seen.
    """

    measured: Float[np.ndarray, "f f"]
    candidates: Float[np.ndarray, "c f f"]
    lengths: Bool[np.ndarray, " f"]
    angles: Bool[np.ndarray, " f"]
    reach_mm: float


def pose_information(
    chain: Chain,
    T_flange_camera: Float[np.ndarray, "4 4"],
    T_target_base: Float[np.ndarray, "t 4 4"],
    measured: PoseData,
    candidates: PoseData,
    scatter: tuple[float, float],
) -> ArmInformation:
    """Return what the measured poses and each candidate say of the arm.

    Parameters
    ----------
    chain, T_flange_camera, T_target_base
        Where the poses are linearised: the identified arm.
    measured, candidates
        Poses with rotations, and as many shared errors of both.
    scatter
        The robot's own standard deviations of each coordinate of position (mm) and rotation (rad).
    """
    seen, further = observations_of(measured), observations_of(candidates)
    arm = ArmState(chain.as_array(), T_flange_camera, T_target_base, np.zeros(seen.common.shape[2]))
    S = Variances(max(scatter[0] ** 2, SMALLEST.position), max(scatter[1] ** 2, SMALLEST.rotation))
    free = fix_gauge(arm, _joined(seen, further), S).free.copy()
    kinematic = int(free.sum())
    free[arm.layout.kinematic :] = True
    everything = information_of(seen, linearised(arm, seen)[1], free, np.ones(len(seen), dtype=np.bool_), S)
    steps = OPEN_SHARE * arm.reach_mm * arm.layout.units(arm.reach_mm)[free]
    least = np.where(np.arange(len(steps)) < kinematic, 1.0 / steps**2, 0.0)
    J = whitened(whitener(further, S), linearised(arm, further)[1][free])
    names = np.array([*JOINT_PARAMETERS * len(chain), *[""] * (arm.layout.size - 5 * len(chain))])[free]
    return ArmInformation(
        everything + np.diag(least),
        np.einsum("pmn,qmn->npq", J, J),
        np.array([name.endswith("_mm") for name in names]),
        np.array([name.endswith("_rad") for name in names]),
        arm.reach_mm,
    )


def _joined(one: Observations, other: Observations) -> Observations:
    assert one.rotations is not None  # poses of images always have one
    assert other.rotations is not None
    return Observations(
        np.concatenate([one.joint_angles, other.joint_angles]),
        np.concatenate([one.positions_mm, other.positions_mm]),
        np.concatenate([one.rotations, other.rotations]),
        np.concatenate([one.own, other.own]),
        np.concatenate([one.common, other.common]),
        np.concatenate([one.target, other.target]),
    )
