"""The paper's two variants as it runs them: closed form, then all parameters refined on the reprojection error (II.H).

What the closed form is decides where the refinement starts, and so whether there is an answer, not which: where both
variants have one the minimum is the same. Variant A is the null space with the principal point at the image's middle
(as printed it has no principal point to give, see `core.calibration.closed_form`), variant B the vanishing points. The
refinement, its weak priors and its refusal of views that do not tell the focal length are `calibrate_points`'; that
one tries other starts where variant B has none, this one fails as the variant does.

References: R. A. Boby, S. K. Saha, ICRA 2016, 10.1109/ICRA.2016.7487395.
"""

from __future__ import annotations

from core.calibration.baselines.result import Baseline, baseline
from core.calibration.closed_form import nullspace, vanishing_point
from core.calibration.conclusion import conclude, judge
from core.calibration.model import (
    FREE,
    SMALLEST_NOISE_PX,
    image_centre,
    retract,
    view_of,
    view_prior,
    view_residuals,
)
from core.calibration.single_image import FOCAL_GATE
from core.calibration.validity import check_points
from core.errors import DegenerateGeometry
from core.least_squares import fit
from core.targets.specification import GridPoints

VARIANTS = {"proposed_nullspace": nullspace, "proposed_vanishing_point": vanishing_point}


def proposed(method: str, points: GridPoints) -> Baseline:
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
    found = conclude(points, judge(points, name, result, FREE, SMALLEST_NOISE_PX), gate=FOCAL_GATE)
    return baseline(method, found.camera, [found.T_camera_target], [found.residuals_px], found.warnings)
