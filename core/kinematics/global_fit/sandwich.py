"""Covariance of the fit by what is left at each pose, whatever the shape of the robot's scatter there.

The fit weighs poses by V_i = C_i + S, with S equal in all directions and at all poses. A robot whose joints scatter is
not so: the far ends of long levers scatter more, across them and not along. The fit is unbiased all the same, and with
J_i the whitened Jacobian of pose i, r_i its residuals and B = (Σ J_iᵀJ_i + prior)⁻¹ its covariance is

    B [Σ J_iᵀ e_i e_iᵀ J_i + prior] B,      e_i = (1 - H_i)⁻¹ r_i,      H_i = J_i B J_iᵀ,

e_i what pose i is off by about the fit to all others: the jackknife's covariance, of poses that are independent of one
another. It is of as many terms as there are poses, so that a combination of parameters which is chosen by it may have
no variance; one that is fixed beforehand has its own. No variance is less than what the stated C_i alone make of it.

References: H. White, Econometrica 48 (1980) 817-838, 10.2307/1912934; J. G. MacKinnon, H. White, J. Econometrics 29
(1985) 305-325, 10.1016/0304-4076(85)90158-7 (HC3); R. M. Bell, D. F. McCaffrey, Survey Methodology 28 (2002) 169-181
(of vectors).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.kinematics.global_fit.fit import FitResult, information_of
from core.kinematics.global_fit.residuals import Observations, whitened, whitener
from core.numerics import covariance_of

_LEAST_LEFT = 1e-6
"""Of a pose's residuals: one that alone determines a parameter leaves nothing."""


def sandwich_covariance(refined: FitResult, seen: Observations) -> Float[np.ndarray, "f f"]:
    """Return the covariance of the free columns, and of the shared errors, of a fit to these poses."""
    used, free = refined.used, refined.free
    kept = seen.take(np.flatnonzero(used))
    W = whitener(kept, refined.scatter)
    J = np.ascontiguousarray(whitened(W, refined.jacobian[free][:, :, used]).T)
    r = whitened(W, refined.residuals[:, used]).T
    B = covariance_of(information_of(seen, refined.jacobian, free, used, refined.scatter))
    left, directions = np.linalg.eigh(np.eye(kept.components) - J @ B @ J.swapaxes(1, 2))
    along = np.einsum("nab,na->nb", directions, r) / np.maximum(left, _LEAST_LEFT)
    e = np.einsum("nab,nb->na", directions, along)
    by_pose = B @ np.einsum("nmf,nm->fn", J, e)
    L = np.moveaxis(W, -1, 0)
    rows = J.reshape(-1, len(B))
    stated = rows.T @ (L @ kept.own @ L.swapaxes(1, 2) @ J).reshape(rows.shape)
    of_shared = B[:, len(B) - seen.common.shape[2] :]
    shared = of_shared @ of_shared.T
    found = by_pose @ by_pose.T + shared
    least = np.diag(B @ stated @ B + shared)
    growth = np.sqrt(np.maximum(least / np.diag(found), 1.0))
    return np.asarray(found * np.outer(growth, growth))
