"""The direct linear transformation on one plane.

In space a point and its image obey u = (L1 x + L2 y + L3 z + L4) / (L9 x + L10 y + L11 z + 1), v likewise with L5-L8:
eleven parameters, which points of one plane do not determine, since with z = 0 everywhere L3, L7 and L11 do not
appear. On a single grid there remain eight parameters, a plane's homography. That is a mapping, not yet a camera; pose,
fx and fy follow from it once a principal point is assumed (the image's middle), by the same two orthonormality
conditions as the paper's variants, with no further adjustment.

Limits: no distortion is modelled, so it stays in the residuals; there are no statistical weights; the rotation is
exact only as the nearest one. `dlt` fails to give a camera where the tilt is about an image axis or none.

References: Y. I. Abdel-Aziz, H. M. Karara, "Direct linear transformation from comparator coordinates into object space
coordinates in close-range photogrammetry", Symposium on Close-Range Photogrammetry 1971, 1-18, reprinted in PE&RS 81
(2015) 103-107, 10.14358/PERS.81.2.103; R. Hartley, A. Zisserman, "Multiple View Geometry", 2nd ed. 2004, section 6.2.4.
"""

from __future__ import annotations

from core.calibration import check_points, from_homography, image_centre
from core.comparison.results import MethodResult
from core.errors import Advisory, DegenerateGeometry
from core.geometry import estimate_homography, map_points
from core.targets import GridPoints


def dlt(points: GridPoints, *, principal_point: tuple[float, float] | None = None) -> MethodResult:
    """Map one flat grid by the eight parameters, and take camera and pose from them where they give one.

    Raises InvalidArgument, and DegenerateGeometry for fewer than four points or points on one line. A view that maps
    but gives no camera comes without one, and with a warning that says why.
    """
    check_points(points)
    plane = points.points_target[:, :2]
    H = estimate_homography(plane, points.points_px)
    residuals = points.points_px - map_points(H, plane)
    centre = image_centre(points) if principal_point is None else principal_point
    try:
        found = from_homography(H, points, centre, single_focal=False)
    except DegenerateGeometry as failure:
        warning = Advisory(
            "camera_not_observable", f"The mapping gives no camera: {failure.detail}", failure.advice
        )
        return MethodResult("dlt", None, (), (residuals,), (warning,))
    return MethodResult("dlt", found.camera, (found.T_camera_target,), (residuals,))
