"""How well poses determine an arm's parameters: the singular values of the Jacobian, and the indices made of them.

With σ_1 ≥ ... ≥ σ_L of the Jacobian of n poses, in units where 1 mm and an angle that moves the arm's end by 1 mm weigh
the same,

    O1 = (σ_1 ... σ_L)^(1/L) / √n     the volume of the confidence ellipsoid (D-optimality)
    O2 = σ_L / σ_1                    its shape: the inverse of the condition number
    O3 = σ_L                          its longest axis: the worst determined combination (E-optimality)
    O4 = σ_L² / σ_1                   the worst amplification of unmodelled errors
    O5 = 1 / (1/σ_1 + ... + 1/σ_L)    the sum of its axes (near A-optimality)

All are larger for better poses. O1 and O2 compare poses as such, whatever their number; O3, O4 and O5 grow with it.

References: J.-H. Borm, C.-H. Menq, Int. J. Robotics Research 10 (1991) 584-597 (O1); M. R. Driels, U. S. Pathre, J.
Robotic Systems 7 (1990) 499-518 (O2); A. Nahvi, J. M. Hollerbach, V. Hayward, ICRA 1994 (O3); A. Nahvi, J. M.
Hollerbach, ICRA 1996 (O4); Y. Sun, J. M. Hollerbach, ICRA 2008 (O5, and what each is of the confidence ellipsoid).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.kinematics.arm_model import ArmState
from core.kinematics.global_fit.residuals import linearised, observations_of
from core.kinematics.pose_observations import PoseData

_SMALLEST_VALUE = 1e-300


@dataclass(frozen=True, slots=True)
class ObservabilityIndices:
    """O1 to O5; O3, O4 and O5 in mm at the arm's end per mm of the parameters."""

    o1: float
    o2: float
    o3: float
    o4: float
    o5: float


@dataclass(frozen=True, slots=True)
class Conditioning:
    """How well poses determine the fitted parameters: the singular values of the Jacobian, in units where 1 mm and an
    angle that moves the arm's end by 1 mm weigh the same; their ratio; and the indices made of them.
    """

    singular_values: Float[np.ndarray, " f"]
    condition_number: float
    indices: ObservabilityIndices

    @property
    def observability_o1(self) -> float:
        """Borm and Menq's index."""
        return self.indices.o1


def observability_indices(singular_values: Float[np.ndarray, " f"], poses: int) -> ObservabilityIndices:
    """Return the five indices of singular values in descending order."""
    values = np.maximum(singular_values, _SMALLEST_VALUE)
    largest, smallest = float(values[0]), float(singular_values[-1])
    return ObservabilityIndices(
        float(np.exp(np.mean(np.log(values)))) / math.sqrt(poses),
        smallest / largest,
        smallest,
        smallest**2 / largest,
        1.0 / float(np.sum(1.0 / values)) if smallest > 0.0 else 0.0,
    )


def conditioning(
    arm: ArmState, J: Float[np.ndarray, "p m n"], free: Bool[np.ndarray, " p"], used: Bool[np.ndarray, " n"]
) -> Conditioning:
    """Return the conditioning of the kinematic columns that are free, over the poses used."""
    chosen = free.copy()
    chosen[arm.layout.kinematic :] = False
    rows = scaled(arm, J[:, :, used])[chosen].reshape(int(chosen.sum()), -1)
    values = np.linalg.svd(np.linalg.qr(rows.T, mode="r"), compute_uv=False)
    smallest = float(values[-1])
    return Conditioning(
        values,
        float(values[0]) / smallest if smallest > 0.0 else math.inf,
        observability_indices(values, int(used.sum())),
    )


def conditioning_of_chain(
    poses: PoseData,
    chain: Float[np.ndarray, "j 5"],
    T_flange_camera: Float[np.ndarray, "4 4"],
    T_target_base: Float[np.ndarray, "t 4 4"],
    identifiable: Bool[np.ndarray, "j 5"],
) -> Conditioning:
    """Return how well poses determine the identifiable parameters of a chain with its tool and bases."""
    seen = observations_of(poses)
    arm = ArmState(chain, T_flange_camera, T_target_base[: seen.layout.targets], np.zeros(seen.layout.shared))
    free = np.ones(arm.layout.size, dtype=np.bool_)
    free[: arm.layout.tool.start] = identifiable.ravel()
    _, J = linearised(arm, seen)
    return conditioning(arm, J, free, np.ones(len(seen), dtype=np.bool_))


def scaled(arm: ArmState, J: Float[np.ndarray, "p m n"]) -> Float[np.ndarray, "p m n"]:
    """Return the Jacobian with all rows in mm at the arm's end and all columns by steps of like weight."""
    scaled = J * arm.layout.units(arm.reach_mm)[:, None, None]
    scaled[:, 3:] *= arm.reach_mm
    return np.asarray(scaled)
