"""The next views that would make a camera most certain, as AprilCal chooses them, after the images taken so far.

Of many candidates the one is taken, again and again, that leaves the smallest mean variance of pixels over the image:
`greedy` with G the mean square of the pixels' derivatives by the camera's parameters.

References: A. Richardson, J. Strom, E. Olson, "AprilCal: assisted and repeatable camera calibration", IROS 2013,
10.1109/IROS.2013.6696595.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.calibration import CommonFit
from core.errors import NoViewShowsTarget
from core.geometry import AnyCamera, camera_from_array
from core.numerics import covariance_of
from core.session.next_view.candidates import candidate_views
from core.session.next_view.information import (
    camera_information,
    placed_views,
    projection_jacobian,
    simulated_views,
)
from core.session.next_view.selection import greedy
from core.targets import TargetSpec

CANDIDATES = 300


@dataclass(frozen=True, slots=True)
class NextViews:
    """Views to take, the most informative first, as T_camera_target (mm), their places among the candidates, and what
    each leaves uncertain.

    `projection_px` and `focal_relative` begin with what is uncertain now and have an entry more for each view: the root
    mean square uncertainty of a pixel over the image, and u(f)/f.
    """

    T_camera_target: Float[np.ndarray, "n 4 4"]
    places: Int[np.ndarray, " n"]
    projection_px: Float[np.ndarray, " m"]
    focal_relative: Float[np.ndarray, " m"]


def suggest_views(
    fit: CommonFit,
    covariance: Float[np.ndarray, "s s"],
    spec: TargetSpec,
    count: int,
    stated: Float[np.ndarray, "n 4 4"] | None = None,
) -> NextViews:
    """Suggest `count` views of a target after those of a fit, of which `covariance` is the camera's.

    They are of those `stated` as T_camera_target (mm), each taken once at most; of any that show the whole target where
    none are stated. Candidates have the fit's noise and the growth of its uncertainties, so that what is predicted is
    what the fit of all of them will state.

    Raises InvalidArgument for no views, NoViewShowsTarget where no candidate shows the whole target.
    """
    camera = camera_from_array(fit.placements.parameters[0])
    size = fit.views.image_width_px, fit.views.image_height_px
    candidates = candidate_views(spec, camera, size, CANDIDATES) if stated is None else stated
    if not len(candidates):
        raise NoViewShowsTarget(
            "No view shows the whole target.", "Use a smaller target, or a lens of a wider angle."
        )
    noise = fit.scale * math.sqrt(fit.growth.camera) * float(np.median(fit.views.uncertainty))
    views = simulated_views(spec, camera, size, candidates, noise)
    information = camera_information(*placed_views(views, camera, candidates))
    free = information.shape[1]
    G = _weights(camera, size, free)
    chosen, left = greedy(
        covariance_of(covariance[:free, :free]), information, G, count, repeat=stated is None
    )
    focal = [math.sqrt(float(C[:2, :2].mean())) / float(camera.as_array()[:2].mean()) for C in left]
    return NextViews(
        candidates[chosen],
        np.array(chosen, dtype=np.intp),
        np.array([math.sqrt(float(np.sum(G * C))) for C in left]),
        np.array(focal),
    )


def _weights(camera: AnyCamera, size_px: tuple[int, int], free: int) -> Float[np.ndarray, "c c"]:
    J = projection_jacobian(camera, size_px, free)
    return np.asarray(J.T @ J / len(J))
