"""Several views, one camera: shared intrinsics and a pose for each view by one robust MAP fit.

The same priors as for one image, so that a view that says nothing of the focal length by itself still helps to fix the
poses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.arrow import TIED
from core.calibration.group_starts import placed, start_focals
from core.calibration.homography import estimate_homography
from core.calibration.model import Lens, image_centre
from core.calibration.shared_lens import SharedLens, fit_shared_lens
from core.calibration.systematic import growth_of_shared
from core.calibration.view_stack import ViewStack, stack_states, stack_views
from core.camera import Camera
from core.errors import InvalidArgument, NotConverged
from core.targets.specification import GridPoints
from core.transforms import transform


@dataclass(frozen=True, slots=True)
class PooledCalibration:
    """One camera from several views.

    `covariance` (9, 9) in the order of `CAMERA_PARAMETERS` (k3 held at 0), `inflation` by how much its standard
    uncertainties are larger than independent residuals would leave them, `T_camera_target` one (4, 4) per view,
    `residuals_px` and `used` per view; of a view unlike the others no point is used.
    """

    camera: Camera
    covariance: Float[np.ndarray, "9 9"]
    T_camera_target: tuple[Float[np.ndarray, "4 4"], ...]
    residuals_px: tuple[Float[np.ndarray, "_ 2"], ...]
    used: tuple[Bool[np.ndarray, " _"], ...]
    rms_px: float
    inflation: float


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
    stack = stack_views(views)
    found = fit_common_camera(stack, lens)
    if not found.converged:
        raise NotConverged("The pooled fit did not converge from any start.")
    growth = growth_of_shared(stack, found, np.arange(len(stack))).camera
    placements, residuals, used = found.at.placements, found.at.residuals, found.used
    origins = placements.translations_mm - np.einsum("kij,kj->ki", placements.rotations, stack.centroids)
    parts = [stack.part(i) for i in range(len(stack))]
    return PooledCalibration(
        camera=Camera.from_array(placements.parameters[0]),
        covariance=growth * found.covariance,
        T_camera_target=tuple(transform(R, t) for R, t in zip(placements.rotations, origins, strict=True)),
        residuals_px=tuple(np.ascontiguousarray(residuals[:, part].T) for part in parts),
        used=tuple(used[part] for part in parts),
        rms_px=float(np.sqrt(np.sum(residuals[:, used] ** 2) / max(int(used.sum()), 1))),
        inflation=math.sqrt(growth),
    )


def fit_common_camera(views: ViewStack, lens: Lens | None) -> SharedLens:
    """Fit one camera from the views' own closed forms or, where none gives a focal length, from assumed ones.

    Raises DegenerateGeometry for points on one line.
    """
    each = [views.view(i) for i in range(len(views))]
    homographies = [estimate_homography(v.points_target[:, :2], v.points_px) for v in each]
    focals = start_focals(list(zip(homographies, each, strict=True)), lens)
    fits = []
    for focal in focals:
        camera = Camera(focal, focal, *image_centre(each[0]))
        start = [placed(H, v, camera, c) for H, v, c in zip(homographies, each, views.centroids, strict=True)]
        fits.append(fit_shared_lens(views, stack_states(start), TIED, lens=lens))
    return min(fits, key=lambda f: (not f.converged, -int(f.kept.sum()), f.scale))
