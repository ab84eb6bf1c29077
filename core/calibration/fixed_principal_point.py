"""Calibration from one image with a fixed principal point: one focal length, k1, k2 and the pose (Table III's setting).

Holding the principal point makes f and depth of one view well determined and the pose's scatter ten times smaller than
with everything free, at the price of a bias of millimetres where the principal point is wrong: good for comparing
images of one pose, not for where the camera is.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from core.calibration import closed_form
from core.calibration.priors import RADIAL_PRIORS, Lens
from core.calibration.residuals import View
from core.calibration.result import MAX_DETERMINED_UNCERTAINTY
from core.calibration.single_image import candidate_focals, closed_form_start
from core.calibration.state import SMALLEST_NOISE_PX, retract, view_of, view_residuals
from core.calibration.validity import check_points
from core.errors import DegenerateGeometry, FocalNotObservable, NotConverged
from core.geometry import Camera, estimate_homography
from core.numerics import Fit, fit
from core.targets import GridPoints

STEP_EMBEDDING = np.zeros((14, 9))
"""From the nine coordinates (f, k1, k2, then a small rotation and a translation) to those of a free view."""
STEP_EMBEDDING[[0, 1], 0] = STEP_EMBEDDING[4, 1] = STEP_EMBEDDING[5, 2] = 1.0
STEP_EMBEDDING[8:, 3:] = np.eye(6)


def fit_fixed_centre(
    points: GridPoints, principal_point: tuple[float, float], lens: Lens | None = None
) -> Fit[View]:
    """Fit f = fx = fy, k1, k2 and the pose; k1 and k2 have the weak priors of any single image.

    The covariance has the coordinates of `STEP_EMBEDDING`. Raises InvalidArgument, DegenerateGeometry,
    FocalNotObservable for a view that does not determine the focal length, NotConverged.
    """
    check_points(points)
    if len(points) < 6:
        raise DegenerateGeometry(
            f"Focal length and pose need at least 6 grid points, {len(points)} were found."
        )
    H = estimate_homography(points.points_target[:, :2], points.points_px)
    plausible = closed_form_start(H, points)
    focals = [plausible.camera.fx_px] if plausible is not None else candidate_focals(points, lens)
    of_view = view_residuals(points, free=True)

    def evaluate(view: View) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "9 2 n"]]:
        residuals, jacobian = of_view(view)
        return residuals, np.tensordot(STEP_EMBEDDING.T, jacobian, axes=1)

    fits = [
        fit(
            evaluate,
            lambda view, step: retract(view, STEP_EMBEDDING @ step),
            view_of(closed_form.nominal(H, points, Camera(f, f, *principal_point)), points),
            points.standard_uncertainty_px,
            prior=radial_prior,
            smallest_scale=SMALLEST_NOISE_PX,
        )
        for f in focals
    ]
    best = min((f for f in fits if f.converged), key=lambda f: f.scale, default=None)
    if best is not None:
        return best
    # Where the focal length is not observable the cost is a flat valley, and the solver does not converge.
    if any(f.status == "singular" or _relative_uncertainty(f) > MAX_DETERMINED_UNCERTAINTY for f in fits):
        raise FocalNotObservable(
            "The focal length is not observable in this view, even with the principal point held."
        )
    raise NotConverged("No focal length explains the grid points with the principal point held.")


def _relative_uncertainty(result: Fit[View]) -> float:
    return math.sqrt(max(float(result.covariance[0, 0]), 0.0)) / float(result.state.parameters[0])


def radial_prior(view: View) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 9"]]:
    """The weak priors on k1 and k2, over the coordinates of `STEP_EMBEDDING`."""
    Q = np.zeros((2, 9))
    Q[0, 1], Q[1, 2] = 1.0 / RADIAL_PRIORS[0], 1.0 / RADIAL_PRIORS[1]
    return -view.parameters[4:6] / np.array(RADIAL_PRIORS), Q
