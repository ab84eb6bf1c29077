"""Several views, one camera: shared intrinsics and a pose for each view by one robust MAP fit.

The same priors and the same solver as for one image, so that a view that says nothing of the focal length by
itself still helps to fix the poses. The state is dense, which serves tens of views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration import closed_form
from core.calibration.homography import estimate_homography
from core.calibration.model import (
    SMALLEST_NOISE_PX,
    Lens,
    View,
    camera_prior,
    centred,
    image_centre,
    view_of,
    view_residuals,
)
from core.calibration.single_image import assumed_focals, plausible_focal
from core.camera import Camera
from core.errors import InvalidArgument, NotConverged
from core.least_squares import Fit, fit
from core.targets.specification import GridPoints
from core.transforms import so3_exp, transform


@dataclass(frozen=True, slots=True)
class PooledCalibration:
    """One camera from several views.

    `covariance` (9, 9) in the order of `CAMERA_PARAMETERS` (k3 held at 0), `T_camera_target` one (4, 4) per
    view, `residuals_px` and `used` per view.
    """

    camera: Camera
    covariance: Float[np.ndarray, "9 9"]
    T_camera_target: tuple[Float[np.ndarray, "4 4"], ...]
    residuals_px: tuple[Float[np.ndarray, "_ 2"], ...]
    used: tuple[Bool[np.ndarray, " _"], ...]
    rms_px: float


State = tuple[View, ...]


def calibrate_views(views: Sequence[GridPoints], *, lens: Lens | None = None) -> PooledCalibration:
    """Estimate one camera and a pose per view from the grid points of several images of the same size.

    Raises InvalidArgument for no views or mixed image sizes, DegenerateGeometry for points on one line,
    NotConverged.
    """
    if not views:
        raise InvalidArgument("At least one view is needed.")
    size = (views[0].image_width_px, views[0].image_height_px)
    if any((v.image_width_px, v.image_height_px) != size for v in views):
        raise InvalidArgument(
            "All views must have the same image size.", "Pool images of one camera setting only."
        )
    homographies = [estimate_homography(v.points_target[:, :2], v.points_px) for v in views]
    found = [f for H, v in zip(homographies, views, strict=True) if (f := plausible_focal(H, v)) is not None]
    focals = [float(np.median(found))] if found else assumed_focals(views[0], lens)
    fits = [_fit(views, _start(views, homographies, focal), lens) for focal in focals]
    best = min((f for f in fits if f.converged), key=lambda f: f.scale, default=None)
    if best is None:
        raise NotConverged("The pooled fit did not converge from any start.")
    return _conclude(views, best)


def _start(
    views: Sequence[GridPoints], homographies: Sequence[Float[np.ndarray, "3 3"]], focal: float
) -> State:
    camera = Camera(focal, focal, *image_centre(views[0]))
    return tuple(
        view_of(closed_form.nominal(H, v, camera), v) for H, v in zip(homographies, views, strict=True)
    )


def _fit(views: Sequence[GridPoints], start: State, lens: Lens | None) -> Fit[State]:
    residual_functions = [view_residuals(v, free=True) for v in views]
    of_camera = camera_prior(views[0].image_width_px, views[0].image_height_px, lens)
    size = 8 + 6 * len(views)

    def evaluate(state: State) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
        parts = [f(view) for f, view in zip(residual_functions, state, strict=True)]
        residuals = np.concatenate([r for r, _ in parts], axis=1)
        jacobian = np.zeros((size, 2, residuals.shape[1]))
        first = 0
        for index, (r, J) in enumerate(parts):
            columns = slice(first, first + r.shape[1])
            jacobian[:8, :, columns] = J[:8]
            jacobian[8 + 6 * index : 14 + 6 * index, :, columns] = J[8:]
            first += r.shape[1]
        return residuals, jacobian

    def retract(state: State, step: Float[np.ndarray, " p"]) -> State:
        parameters = state[0].parameters.copy()
        parameters[:2] *= np.exp(np.clip(step[:2] / parameters[:2], -0.7, 0.7))
        parameters[2:8] += step[2:8]
        poses = step[8:].reshape(-1, 6)
        return tuple(
            View(parameters, so3_exp(d[:3]) @ view.rotation, view.translation_mm + d[3:])
            for view, d in zip(state, poses, strict=True)
        )

    def prior(state: State) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]:
        q, Q = of_camera(state[0].parameters)
        padded = np.zeros((len(q), size))
        padded[:, :8] = Q
        return q, padded

    uncertainty = np.concatenate([v.standard_uncertainty_px for v in views])
    return fit(
        evaluate,
        retract,
        start,
        uncertainty,
        prior=prior,
        smallest_scale=SMALLEST_NOISE_PX,
        iteration_limit=100,
    )


def _conclude(views: Sequence[GridPoints], result: Fit[State]) -> PooledCalibration:
    covariance = np.zeros((9, 9))
    covariance[:8, :8] = result.covariance[:8, :8]
    ends = np.cumsum([len(v) for v in views])[:-1]
    residuals = tuple(np.ascontiguousarray(r.T) for r in np.split(result.residuals, ends, axis=1))
    kept = result.residuals[:, result.used]
    return PooledCalibration(
        camera=result.state[0].camera,
        covariance=covariance,
        T_camera_target=tuple(
            transform(view.rotation, view.translation_mm - view.rotation @ centred(points)[1])
            for view, points in zip(result.state, views, strict=True)
        ),
        residuals_px=residuals,
        used=tuple(np.split(result.used, ends)),
        rms_px=float(np.sqrt(np.mean(np.sum(kept**2, axis=0)))),
    )
