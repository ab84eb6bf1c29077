"""The paper's two variants as it runs them: closed form, then all parameters refined on the reprojection error (II.H).

What the closed form is decides where the refinement starts, and so whether there is an answer, not which: where both
variants have one the minimum is the same. Variant A is the null space with the principal point at the image's middle
(as printed it has no principal point to give, see `core.calibration.closed_form`), variant B the vanishing points. The
refinement, its weak priors and its refusal of views that do not determine the focal length are `calibrate_points`';
that one tries other starts where variant B has none, this one fails as the variant does.

References: R. A. Boby, S. K. Saha, ICRA 2016, 10.1109/ICRA.2016.7487395.
"""

from __future__ import annotations

from core.calibration import (
    FREE,
    MAX_FOCAL_UNCERTAINTY,
    SMALLEST_NOISE_PX,
    calibration_of,
    check_points,
    image_centre,
    nullspace,
    retract,
    summarise_fit,
    vanishing_point,
    view_of,
    view_prior,
    view_residuals,
)
from core.comparison.results import MethodResult
from core.errors import DegenerateGeometry
from core.numerics import fit
from core.targets import GridPoints

VARIANTS = {"proposed_nullspace": nullspace, "proposed_vanishing_point": vanishing_point}


def proposed(method: str, points: GridPoints) -> MethodResult:
    """Calibrate one view by a variant of the paper, a key of `VARIANTS`.

    Raises InvalidArgument, DegenerateGeometry where the closed form fails, FocalNotObservable, NotConverged.
    """
    check_points(points)
    if len(points) < 8:
        raise DegenerateGeometry(f"Camera and pose need at least 8 grid points, {len(points)} were found.")
    start = view_of(VARIANTS[method](points, image_centre(points)), points)
    result = fit(
        view_residuals(points, free=True),
        retract,
        start,
        points.standard_uncertainty_px,
        prior=view_prior(points, None),
        smallest_scale=SMALLEST_NOISE_PX,
    )
    name = method.removeprefix("proposed_")
    found = calibration_of(
        points,
        summarise_fit(points, name, result, FREE, SMALLEST_NOISE_PX),
        max_focal_uncertainty=MAX_FOCAL_UNCERTAINTY,
    )
    return MethodResult(method, found.camera, (found.T_camera_target,), (found.residuals_px,), found.warnings)
