"""The repeatability that joint noise predicts: ellipsoid and RP_l of ISO 9283 at any joint angles, with uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from core.kinematics import ArmState, JointNoise, joint_jacobian, scatter_covariance
from core.metrology import CONFIDENCE, eigenvalues, long_run_rp

NORMAL_FACTOR = float(ndtri(0.5 + 0.5 * CONFIDENCE))
_STEP = 1e-5  # of the trace, to differentiate by
_MOST = 5.0
"""Standard uncertainties of RP_l² by which the upper bound is above it at most: where the noise is hardly seen, or not
at all, a normal logarithm would have bounds of metres."""


@dataclass(frozen=True, slots=True)
class PredictedScatter:
    """Predicted at joint angles: the covariance of the position (mm², axes of instrument or target), RP_l after
    endless cycles (mm) with the standard uncertainty by the slope of RP_l over its value, the share of the variance
    that the joints make, and the standard deviation of a rotation (rad; None unless rotations were measured).
    """

    covariance_mm2: Float[np.ndarray, "n 3 3"]
    rp_l_mm: Float[np.ndarray, " n"]
    relative_uncertainty: Float[np.ndarray, " n"]
    joint_share: Float[np.ndarray, " n"]
    rotation_deviation: Float[np.ndarray, " n"] | None

    @property
    def standard_uncertainty_mm(self) -> Float[np.ndarray, " n"]:
        """That of RP_l, at most what the upper bound says: at no noise RP_l has no slope."""
        upper = self.interval()[1]
        return np.minimum(self.rp_l_mm * self.relative_uncertainty, (upper - self.rp_l_mm) / NORMAL_FACTOR)

    def interval(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the bounds of RP_l at the confidence level, its logarithm normal; `_MOST` limits the upper one."""
        reach = NORMAL_FACTOR * self.relative_uncertainty
        above = np.minimum(reach, 0.5 * np.log1p(2.0 * _MOST * self.relative_uncertainty))
        return self.rp_l_mm * np.exp(-reach), self.rp_l_mm * np.exp(above)


def predict_scatter(
    noise: JointNoise, arm: ArmState, joint_angles: Float[np.ndarray, "n j"]
) -> PredictedScatter:
    """Return what the noise predicts at joint angles (rad), of the measured point: camera, probe or reflector."""
    J = joint_jacobian(arm, joint_angles, np.zeros(len(joint_angles), dtype=np.intp))
    theta, joints = noise.variances, noise.joints
    of_joints = J[:, :3]
    covariance = scatter_covariance(of_joints, theta)
    rp = long_run_rp(eigenvalues(covariance))
    trace = np.trace(covariance, axis1=1, axis2=2)
    gradient = np.zeros((len(J), len(theta)))
    for k in range(joints + 1):
        if k < joints:
            change = of_joints[:, :, k : k + 1] * of_joints[:, None, :, k]
        else:
            change = np.broadcast_to(np.eye(3), covariance.shape)
        size = np.trace(change, axis1=1, axis2=2)
        moving = size > 1e-12 * trace.max()
        step = _STEP * trace / np.where(moving, size, 1.0)
        moved = long_run_rp(eigenvalues(covariance + step[:, None, None] * change))
        gradient[:, k] = np.where(moving, (moved - rp) / step, 0.0)
    variance = np.einsum("np,pq,nq->n", gradient, noise.covariance, gradient)
    own = np.einsum("nmj,nmj,j->n", of_joints, of_joints, theta[:joints])
    rotation = None
    if len(theta) == joints + 2:
        turned = np.einsum("nmj,nmj,j->n", J[:, 3:], J[:, 3:], theta[:joints]) / 3.0 + theta[-1]
        rotation = np.sqrt(turned) / noise.reach_mm
    return PredictedScatter(
        covariance,
        rp,
        np.sqrt(np.maximum(variance, 0.0)) / np.maximum(rp, 1e-300),
        own / np.maximum(trace, 1e-300),
        rotation,
    )
