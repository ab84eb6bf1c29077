"""How uncertain a lens leaves the projection of points at infinity.

A pixel q of the camera b shows the direction d(q). With the errors δb of the parameters and w of the rotation,

    δq = J_b δb + J_w w,   J_b = ∂π/∂b,   J_w = -∂π/∂d [d]×,

both at d(q). The camera's frame is one with its lens: a principal point that is off projects as a turned
camera does, and whoever uses the camera estimates its pose with that same lens. A rotation is therefore no error of the
projection. The one that takes up most of δb over the observed points pᵢ, with weights nᵢ,

    w = -A δb,   A = (Σ nᵢ J_wᵀ J_w)⁻¹ Σ nᵢ J_wᵀ J_b,

is compensated, and Cov(q) = (J_b - J_w A) Cov(b) (J_b - J_w A)ᵀ. Points at infinity do not see a translation.

References: D. Kogan, mrcal 2.4 (2024), "Projection uncertainty" and "Projection differences": uncertainties at
infinity, and the rotation between two calibrations of one camera that a fit of their directions finds.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from core.geometry.lens_inverse import undistort_any
from core.geometry.lens_models import AnyCamera, project_any_with_jacobian
from core.geometry.se3 import hats


def projection_covariance(
    points_px: Float[np.ndarray, "n 2"],
    camera: AnyCamera,
    camera_covariance: Float[np.ndarray, "s s"],
    observed_px: Float[np.ndarray, "m 2"],
    weights: Float[np.ndarray, " m"],
) -> Float[np.ndarray, "n 2 2"]:
    """Return the covariance (px²) of where a point at infinity is projected, at pixels; see the module.

    Parameters
    ----------
    camera, camera_covariance
        The parameters, and their covariance in the order of the model's `LENS_PARAMETERS`.
    observed_px, weights
        Over which pixels a rotation of the camera takes up the lens's error, and how much each counts.

    Returns
    -------
    NaN where the lens model has no direction for the pixel (`undistort_any`).
    """
    by_lens, by_rotation = _derivatives(observed_px, camera)
    sound = np.isfinite(by_rotation).all(axis=(1, 2))
    J_b, J_w, n = by_lens[sound], by_rotation[sound], weights[sound]
    information = np.einsum("n,nai,naj->ij", n, J_w, J_w)
    # Of two points or fewer some rotation may be undetermined; then none about that axis is compensated.
    A = np.linalg.pinv(information, hermitian=True) @ np.einsum("n,nai,naj->ij", n, J_w, J_b)
    by_lens, by_rotation = _derivatives(points_px, camera)
    J = by_lens - by_rotation @ A
    return np.asarray(J @ camera_covariance @ np.swapaxes(J, 1, 2))


def worst_direction(covariance: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, " n"]:
    """Return the standard uncertainty (px) along the direction in which it is largest; NaN where it is unknown."""
    half_trace = 0.5 * (covariance[:, 0, 0] + covariance[:, 1, 1])
    half_difference = 0.5 * (covariance[:, 0, 0] - covariance[:, 1, 1])
    return np.asarray(np.sqrt(half_trace + np.hypot(half_difference, covariance[:, 0, 1])))


def _derivatives(
    points_px: Float[np.ndarray, "n 2"], camera: AnyCamera
) -> tuple[Float[np.ndarray, "n 2 s"], Float[np.ndarray, "n 2 3"]]:
    """Return J_b and J_w at pixels, NaN where they have no direction."""
    plane = undistort_any(points_px, camera)
    sound = np.isfinite(plane).all(axis=1)
    directions = np.column_stack([np.where(sound[:, None], plane, 0.0), np.ones(len(plane))])
    _, by_camera, by_point = project_any_with_jacobian(directions, camera)
    J_b = np.transpose(by_camera, (2, 1, 0)).copy()
    J_w = -np.transpose(by_point, (2, 1, 0)) @ hats(directions)
    J_b[~sound] = J_w[~sound] = np.nan
    return J_b, J_w
