"""Images that are each fitted by themselves, fitted again with the points that their pose's images have in common.

Each image's own fit decides on its own points; where repeated images came to different ones, their poses differ by what
is systematic in those points (see `inliers`).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.fixed_centre import TO_FULL_STEP, radial_prior
from core.calibration.inliers import find_repeats, inliers_of
from core.calibration.model import (
    SMALLEST_NOISE_PX,
    Lens,
    View,
    retract,
    view_prior,
    view_residuals,
)
from core.calibration.shared_lens import Linearised
from core.calibration.view_stack import ViewStack
from core.errors import NotConverged
from core.least_squares import Prior, fit
from core.targets.specification import GridPoints


def points_in_common(
    views: ViewStack, at: Linearised, labels: Int[np.ndarray, " m"]
) -> Bool[np.ndarray, " n"]:
    """Return which points count, decided for all views of a label together."""
    everyone = np.ones(len(views), dtype=np.bool_)
    return inliers_of(views, find_repeats(views, labels), at.residuals, everyone)


def fit_again(
    points: GridPoints,
    start: View,
    used: Bool[np.ndarray, " n"],
    *,
    centre_held: bool,
    lens: Lens | None,
) -> View:
    """Fit one image plainly with the points `used`; everything free, or f, k1, k2 and the pose alone.

    Raises NotConverged.
    """
    step = TO_FULL_STEP if centre_held else np.eye(14)
    of_view = view_residuals(points, free=True)
    prior: Prior[View] = radial_prior if centre_held else view_prior(points, lens)

    def evaluate(view: View) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
        residuals, jacobian = of_view(view)
        return residuals, np.tensordot(step.T, jacobian, axes=1)

    found = fit(
        evaluate,
        lambda view, by: retract(view, step @ by),
        start,
        points.standard_uncertainty_px,
        prior=prior,
        smallest_scale=SMALLEST_NOISE_PX,
        used=used,
    )
    if not found.converged:
        raise NotConverged(
            "The grid points that this image shares with the others of its pose do not determine it.",
            "Look at its overlay: reflections, dirt or something in front of the grid are the usual causes.",
        )
    return found.state
