"""Straight lines of one view: distortion from their straightness, then camera and pose from the lines themselves.

The grid's rows and columns are straight. One coefficient λ of the division model, x = x' / (1 + λ |x'|²) about the
image's middle, is the one that leaves them straightest. Lines l fitted to the undistorted points, with L the same lines
on the grid, obey L ~ Hᵀ l; H from all lines gives one focal length and the pose, with the principal point at the
image's middle and square pixels. In this package's model k1 = λ f², to first order in λ.

Written after the title and abstract of the reference and its mention by Boby and Saha; the published method's own
adjustment is not repeated: nothing is refined on the points.

Limits and how it fails: tangential terms and a second radial one are not modelled. Lines through the image's middle are
straight whatever λ is: a small grid there leaves λ to noise (`distortion_not_observable`). A grid parallel to the image
gives no focal length, and so it is with tilts that noise exceeds (`degenerate_geometry`). Two rows and two columns of
three points or more are needed.

References: F. Zhou, Y. Cui, H. Gao, Y. Wang, "Line-based camera calibration with lens distortion correction from a
single image", Optics and Lasers in Engineering 51 (2013) 1332-1343, 10.1016/j.optlaseng.2013.05.007.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize_scalar

from core.calibration import check_points, from_homography, image_centre
from core.comparison.results import MethodResult
from core.comparison.single_focal_fit import require_plausible
from core.errors import Advisory, DegenerateGeometry
from core.geometry import Camera, project, transform_points
from core.targets import GridPoints

MIN_LINE_POINTS = 3
MAX_DIVISION = 1.0
"""Of λ times the square of half the image's diagonal: no lens that keeps lines in view bends them more."""
MAX_DIVISION_UNCERTAINTY = 0.05
"""Of the same product: a larger standard uncertainty leaves the distortion to noise."""


def lines(points: GridPoints) -> MethodResult:
    """Calibrate from the lines of one view; residuals are of all of its points.

    Raises InvalidArgument, DegenerateGeometry where lines are too few or give no focal length.
    """
    check_points(points)
    members = _members(points)
    centre = np.array(image_centre(points))
    half = 0.5 * float(np.hypot(points.image_width_px, points.image_height_px))
    unit = (points.points_px - centre) / half
    found = minimize_scalar(
        lambda value: _bend(_undistorted(unit, value), [some for some, _ in members]),
        bounds=(-MAX_DIVISION, MAX_DIVISION),
        method="bounded",
        options={"xatol": 1e-9},
    )
    division = float(found.x)
    straight = _undistorted(unit, division)
    H = _homography(straight, members)
    to_pixels = np.array([[half, 0.0, centre[0]], [0.0, half, centre[1]], [0.0, 0.0, 1.0]])
    start = from_homography(to_pixels @ H, points, image_centre(points), single_focal=True)
    f = start.camera.fx_px
    require_plausible(f, points)
    camera = Camera(f, f, float(centre[0]), float(centre[1]), division * (f / half) ** 2)
    T = start.T_camera_target
    residuals = points.points_px - project(transform_points(T, points.points_target), camera)
    return MethodResult("lines", camera, (T,), (residuals,), _warnings(unit, members, division))


def _members(points: GridPoints) -> list[tuple[Int[np.ndarray, " _"], Float[np.ndarray, "3"]]]:
    """Return the points of each row and column, and its line on the grid: a X + b Y + c = 0."""
    found = []
    plane = points.points_target
    counts = []
    for index, axis in ((points.row, 1), (points.column, 0)):
        taken = 0
        for one in np.unique(index):
            some = np.flatnonzero(index == one)
            if len(some) >= MIN_LINE_POINTS:
                line = np.zeros(3)
                line[axis], line[2] = 1.0, -float(plane[some, axis].mean())
                found.append((some, line))
                taken += 1
        counts.append(taken)
    if min(counts) < 2:
        raise DegenerateGeometry(
            f"The line-based method needs two rows and two columns of {MIN_LINE_POINTS} points or more."
        )
    return found


def _undistorted(unit: Float[np.ndarray, "n 2"], division: float) -> Float[np.ndarray, "n 2"]:
    return unit / (1.0 + division * np.sum(unit**2, axis=1))[:, None]


def _fitted(line: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "3"], float]:
    """Return the line of least squared distances (unit normal), and their sum."""
    middle = line.mean(axis=0)
    _, singular, Vt = np.linalg.svd(line - middle, full_matrices=False)
    normal = Vt[1]
    return np.array([normal[0], normal[1], -float(normal @ middle)]), float(singular[1] ** 2)


def _bend(straight: Float[np.ndarray, "n 2"], members: list[Int[np.ndarray, " _"]]) -> float:
    """Return the sum of squared distances from straight lines, by the square of the grid's size in the image."""
    return sum(_fitted(straight[some])[1] for some in members) / float(np.var(straight))


def _homography(
    straight: Float[np.ndarray, "n 2"], members: list[tuple[Int[np.ndarray, " _"], Float[np.ndarray, "3"]]]
) -> Float[np.ndarray, "3 3"]:
    """Return H of the lines, grid to image, by L × Hᵀ l = 0 with both normalised."""
    length = max(abs(float(L[2])) for _, L in members) or 1.0
    rows = []
    for some, L in members:
        a, b, c = L / [1.0 / length, 1.0 / length, 1.0] / length
        seen, _ = _fitted(straight[some])
        zero = np.zeros(3)
        rows += [
            np.concatenate([zero, -c * seen, b * seen]),
            np.concatenate([c * seen, zero, -a * seen]),
            np.concatenate([-b * seen, a * seen, zero]),
        ]
    _, singular, Vt = np.linalg.svd(np.array(rows))
    if singular[7] < 1e-9 * singular[0]:
        raise DegenerateGeometry("The lines do not determine the view.")
    return np.asarray(Vt[8].reshape(3, 3).T @ np.diag([1.0 / length, 1.0 / length, 1.0]))


def _warnings(
    unit: Float[np.ndarray, "n 2"],
    members: list[tuple[Int[np.ndarray, " _"], Float[np.ndarray, "3"]]],
    division: float,
) -> tuple[Advisory, ...]:
    """Warn where straightness leaves λ uncertain, by its curvature at the noise that the lines show."""
    some = [one for one, _ in members]
    step = 1e-3
    least, more, less = (_bend(_undistorted(unit, division + s), some) for s in (0.0, step, -step))
    curvature = (more + less - 2.0 * least) / step**2
    dof = max(sum(len(one) - 2 for one in some) - 1, 1)
    if curvature > 0.0 and np.sqrt(2.0 * least / dof / curvature) <= MAX_DIVISION_UNCERTAINTY:
        return ()
    return (
        Advisory(
            "distortion_not_observable",
            "The lines are straight whatever the distortion is: it is left to noise.",
            "Let the grid fill more of the image.",
        ),
    )
