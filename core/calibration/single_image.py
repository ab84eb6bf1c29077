"""One image: starts, MAP refinement, the refusal, and the doubt of what is left.

State: the camera's nine parameters (k3 held at the start's value) and T_camera_target with a left perturbation, R ← exp(w) R,
t ← t + d. One planar view separates focal length and principal point from depth only through tilt and distortion, so
weak priors (METHOD: what lenses are like) regularise the fit, and a view whose predicted u(f)/f still exceeds 2 % is
refused: its residual would be as small as ever while its pose is millimetres off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.calibration import closed_form
from core.calibration.homography import estimate_homography
from core.calibration.result import Calibration, Observability
from core.calibration.uncertainty import camera_pose, correlation_inflation, remarks, reprojection
from core.camera import CAMERA_PARAMETERS, Camera, project_with_jacobian, undistort_points
from core.errors import Advisory, DegenerateGeometry, FocalNotObservable, InvalidArgument, NotConverged
from core.least_squares import Evaluate, Fit, Prior, fit
from core.targets.specification import GridPoints
from core.transforms import hat, so3_exp, transform

FOCAL_GATE = 0.02
"""Largest predicted u(f)/f that is reported as a measurement."""
LENS_PRIOR = 0.05
"""Relative standard uncertainty of a focal length computed from the lens's engraving and the pixel pitch."""
PRINCIPAL_POINT_PRIOR = 0.01  # of the image width, about the centre
ASPECT_PRIOR = 1e-3
TANGENTIAL_PRIOR = 3e-4
RADIAL_PRIORS = (0.3, 0.5)
START_FACTORS = (0.6, 1.0, 1.8)  # of the image width, where no closed form is plausible
PLAUSIBLE_START = (0.3, 10.0)

# Step coordinates of the two estimators within the 15 of `result.STATE`.
FREE = np.array([0, 1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 14])
POSE = np.arange(9, 15)


@dataclass(frozen=True, slots=True)
class Lens:
    """What the user knows of the lens: f = focal_length_mm / pixel_pitch_um, good to 5 %."""

    focal_length_mm: float
    pixel_pitch_um: float

    def __post_init__(self) -> None:
        if not (0 < self.focal_length_mm < math.inf and 0 < self.pixel_pitch_um < math.inf):
            raise InvalidArgument("focal_length_mm and pixel_pitch_um must be positive numbers.")

    @property
    def focal_px(self) -> float:
        return 1000.0 * self.focal_length_mm / self.pixel_pitch_um


@dataclass(frozen=True, slots=True)
class View:
    """The state of a fit: camera parameters in the order of `CAMERA_PARAMETERS`, rotation, and the position of the grid
    points' centroid in the camera frame (mm): turning about the centroid decouples rotation from translation."""

    parameters: Float[np.ndarray, "9"]
    rotation: Float[np.ndarray, "3 3"]
    translation_mm: Float[np.ndarray, "3"]

    @property
    def camera(self) -> Camera:
        return Camera.from_array(self.parameters)


def calibrate_points(
    points: GridPoints, *, lens: Lens | None = None, intrinsics: Camera | None = None
) -> Calibration:
    """Estimate camera and pose from the grid points of one image.

    With `intrinsics` given only the pose is estimated (estimator "given") and they are taken as exact; else all is
    (estimator "per_image"), with a 5 % prior on the focal length if `lens` is given.

    Raises DegenerateGeometry for too few or collinear points, NotConverged, and FocalNotObservable where the predicted
    u(f)/f exceeds 2 % (with a lens prior: 5 %); each carries the points.
    """
    try:
        if intrinsics is not None:
            start, view_fit = "nominal", _fit_pose(points, intrinsics)
            indices, gate = POSE, math.inf
        else:
            start, view_fit = _fit_all(points, lens)
            indices, gate = FREE, FOCAL_GATE if lens is None else max(FOCAL_GATE, LENS_PRIOR)
        return _conclude(points, start, view_fit, indices, gate, lens)
    except (DegenerateGeometry, NotConverged, FocalNotObservable) as failure:
        failure.points = points
        raise


def _centred(points: GridPoints) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "3"]]:
    """Return the grid points about their centroid, and the centroid (target frame, mm)."""
    target = points.points_target
    centroid = target.mean(axis=0)
    return target - centroid, centroid


def _evaluate(points: GridPoints, indices: Int[np.ndarray, " p"]) -> Evaluate[View]:
    """Return the residual function over the chosen step coordinates."""
    target, observed = _centred(points)[0], points.points_px.T

    def evaluate(view: View) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
        rotated = target @ view.rotation.T  # about the centroid
        pixels, by_camera, by_point = project_with_jacobian(rotated + view.translation_mm, view.camera)
        X, Y, Z = rotated.T
        jacobian = np.empty((15, 2, len(target)))
        jacobian[:9] = by_camera
        # d(exp(w) R x)/dw = w × (R x), one axis at a time.
        jacobian[9] = by_point[2] * Y - by_point[1] * Z
        jacobian[10] = by_point[0] * Z - by_point[2] * X
        jacobian[11] = by_point[1] * X - by_point[0] * Y
        jacobian[12:] = by_point
        return observed - pixels, jacobian[indices]

    return evaluate


def _retract_pose(view: View, step: Float[np.ndarray, "6"]) -> View:
    return View(view.parameters, so3_exp(step[:3]) @ view.rotation, view.translation_mm + step[3:])


def _retract(view: View, step: Float[np.ndarray, "14"]) -> View:
    """Move along a curve with tangent `step` that follows the valley of one-image calibration.

    Under weak perspective the image hardly changes while f, depth and tilt grow in proportion, k1 with f² and k2 with f⁴.
    A straight step leaves that curved valley at second order and the solver creeps; this curve stays in it. Its tangent is
    the plain step's, so Jacobian and covariance are untouched.
    """
    parameters = view.parameters.copy()
    ratio = float(np.clip(0.5 * (step[0] / parameters[0] + step[1] / parameters[1]), -0.7, 0.7))
    growth = math.expm1(ratio) / ratio if abs(ratio) > 1e-8 else 1.0
    parameters[:2] *= np.exp(np.clip(step[:2] / parameters[:2], -0.7, 0.7))
    parameters[2:8] += step[2:8]
    parameters[4] += parameters[4] * (math.expm1(2.0 * ratio) - 2.0 * ratio)
    parameters[5] += parameters[5] * (math.expm1(4.0 * ratio) - 4.0 * ratio)
    # The centroid's image f·x/z + c keeps its first-order motion, however far f and depth go.
    depth = view.translation_mm[2]
    new_depth = depth * math.exp(float(np.clip(step[-1] / depth, -0.7, 0.7)))
    direction = view.translation_mm[:2] / depth
    image = view.parameters[:2] * direction
    image += step[:2] * direction + view.parameters[:2] * (step[-3:-1] - direction * step[-1]) / depth
    translation = np.append(image / parameters[:2] * new_depth, new_depth)
    return View(parameters, so3_exp(step[-6:-3] * growth) @ view.rotation, translation)


def _prior(points: GridPoints, lens: Lens | None) -> Prior[View]:
    """Gaussian priors on the camera; the one on log(fx/fy) is scale-free, as is that on log f."""
    width = points.image_width_px
    centre = image_centre(points)
    sigma_centre = PRINCIPAL_POINT_PRIOR * width
    names = 7 + (lens is not None)
    Q = np.zeros((names, len(FREE)))
    Q[0, 2] = Q[1, 3] = 1.0 / sigma_centre
    Q[2, 4], Q[3, 5] = 1.0 / RADIAL_PRIORS[0], 1.0 / RADIAL_PRIORS[1]
    Q[4, 6] = Q[5, 7] = 1.0 / TANGENTIAL_PRIOR

    def prior(view: View) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]:
        fx, fy, cx, cy, k1, k2, p1, p2, _ = view.parameters
        q = np.empty(names)
        q[0], q[1] = (centre[0] - cx) / sigma_centre, (centre[1] - cy) / sigma_centre
        q[2], q[3] = -k1 / RADIAL_PRIORS[0], -k2 / RADIAL_PRIORS[1]
        q[4], q[5] = -p1 / TANGENTIAL_PRIOR, -p2 / TANGENTIAL_PRIOR
        if fx <= 0 or fy <= 0:
            q[6:] = math.inf  # no camera; the step is refused
            return q, Q
        q[6] = -math.log(fx / fy) / ASPECT_PRIOR
        Q[6, 0], Q[6, 1] = 1.0 / (fx * ASPECT_PRIOR), -1.0 / (fy * ASPECT_PRIOR)
        if lens is not None:
            q[7] = math.log(lens.focal_px / math.sqrt(fx * fy)) / LENS_PRIOR
            Q[7, 0], Q[7, 1] = 0.5 / (fx * LENS_PRIOR), 0.5 / (fy * LENS_PRIOR)
        return q, Q

    return prior


def image_centre(points: GridPoints) -> tuple[float, float]:
    """The image's middle in pixel-centre coordinates."""
    return 0.5 * (points.image_width_px - 1), 0.5 * (points.image_height_px - 1)


def _starts(points: GridPoints, lens: Lens | None) -> list[tuple[str, closed_form.ClosedForm]]:
    """Closed form B1 where plausible; otherwise assumed focal lengths (the lens's own where stated)."""
    H = estimate_homography(points.points_target[:, :2], points.points_px)
    centre, width = image_centre(points), points.image_width_px
    starts: list[tuple[str, closed_form.ClosedForm]] = []
    try:
        candidate = closed_form.from_homography(H, points, centre, single_focal=True)
        if PLAUSIBLE_START[0] * width < candidate.camera.fx_px < PLAUSIBLE_START[1] * width:
            starts.append(("vanishing_point", candidate))
    except DegenerateGeometry:
        pass  # not a failure: near fronto-parallel views have no closed form, and get the assumed ones below
    if not starts or lens is not None:
        focals = [lens.focal_px] if lens is not None else [factor * width for factor in START_FACTORS]
        for focal in focals:
            starts.append(("nominal", closed_form.nominal(H, points, Camera(focal, focal, *centre))))
    return starts


def _view(start: closed_form.ClosedForm, points: GridPoints) -> View:
    rotation = start.T_camera_target[:3, :3]
    centroid = rotation @ _centred(points)[1] + start.T_camera_target[:3, 3]
    return View(start.camera.as_array(), rotation, centroid)


def _fit_all(points: GridPoints, lens: Lens | None) -> tuple[str, Fit[View]]:
    """Refine every start and keep the one of least cost."""
    if len(points) < 8:
        raise DegenerateGeometry(f"Camera and pose need at least 8 grid points, {len(points)} were found.")
    evaluate, prior = _evaluate(points, FREE), _prior(points, lens)
    fits = [
        (name, fit(evaluate, _retract, _view(start, points), points.standard_uncertainty_px, prior=prior))
        for name, start in _starts(points, lens)
    ]
    converged = [item for item in fits if item[1].converged]
    # By median-based scale through the same points: a fit that rejects half of them is no better for it.
    return min(converged or fits, key=lambda item: _total(item[1], points))


def _total(result: Fit[View], points: GridPoints) -> float:
    """A cost comparable between fits of the same points with different σ and rejections: the negative log posterior."""
    distance = np.sqrt(np.sum(result.residuals**2, axis=0))
    scale = max(result.scale, 1e-10)
    return float(2.0 * len(points) * math.log(scale) + np.sum(np.minimum((distance / scale) ** 2, 32.0)))


def _fit_pose(points: GridPoints, camera: Camera) -> Fit[View]:
    if len(points) < 5:
        raise DegenerateGeometry(f"A pose needs at least 5 grid points, {len(points)} were found.")
    # The homography of undistorted points, so that a strong lens does not spoil the start.
    normalised = undistort_points(points.points_px, camera)
    H = camera.matrix @ estimate_homography(points.points_target[:, :2], normalised)
    start = closed_form.nominal(H, points, camera)
    return fit(_evaluate(points, POSE), _retract_pose, _view(start, points), points.standard_uncertainty_px)


def _conclude(
    points: GridPoints,
    start: str,
    result: Fit[View],
    indices: Int[np.ndarray, " p"],
    gate: float,
    lens: Lens | None,
) -> Calibration:
    """Turn a fit into a Calibration, or refuse it."""
    if result.status == "singular":
        raise DegenerateGeometry("The grid points found do not determine the camera and its pose.")
    view = result.state
    target, centroid = _centred(points)
    depth = target @ view.rotation[2] + view.translation_mm[2]
    if np.any(depth <= 0):
        raise DegenerateGeometry("The best fit puts grid points behind the camera.")
    residuals = np.ascontiguousarray(result.residuals.T)
    inflation, rho = correlation_inflation(points, residuals, result.used)
    # From the centroid to the target's origin: t = t_c - R c, so d = d_c + [R c]× w.
    origin = -view.rotation @ centroid
    to_origin = np.eye(15)
    to_origin[12:, 9:12] = -hat(origin)
    covariance = np.zeros((15, 15))
    covariance[np.ix_(indices, indices)] = result.covariance * inflation**2
    covariance = to_origin @ covariance @ to_origin.T
    conditional = np.linalg.inv(result.information[-6:, -6:]) * inflation**2
    conditional = to_origin[9:, 9:] @ conditional @ to_origin[9:, 9:].T
    translation = view.translation_mm + origin
    focal, focal_uncertainty = _focal(view.camera, covariance)
    # Where focal length cannot be told the cost is a flat valley, on which the solver may walk on without end: that is
    # the refusal's case too, not a failure to converge.
    if focal_uncertainty > gate:
        raise FocalNotObservable(
            f"The focal length is not observable in this view: its predicted standard uncertainty is "
            f"{100 * focal_uncertainty:.1f} % of {focal:.0f} px, more than {100 * gate:.0f} %."
        )
    if not result.converged:
        raise NotConverged(f"The fit did not converge within {result.iterations} iterations.")
    pose = camera_pose(view.rotation, translation, covariance[9:, 9:], conditional)
    statistics = reprojection(residuals, result.used)
    chi = result.scale / float(np.mean(points.standard_uncertainty_px))
    warnings = remarks(points, pose, statistics, chi, inflation, rho)
    if len(indices) == len(POSE):
        warnings.append(
            Advisory(
                "intrinsics_taken_as_exact",
                "The session's intrinsics were used as given; the pose's uncertainty does not contain theirs.",
            )
        )
    elif lens is not None and abs(math.log(lens.focal_px / focal)) > 3.0 * LENS_PRIOR:
        warnings.append(
            Advisory(
                "lens_prior_contradicted",
                f"The image says f = {focal:.0f} px, the stated lens {lens.focal_px:.0f} px.",
                "Check the lens's focal length and the camera's pixel pitch (binning doubles it).",
            )
        )
    return Calibration(
        estimator="given" if len(indices) == len(POSE) else "per_image",
        start=start,
        image_width_px=points.image_width_px,
        image_height_px=points.image_height_px,
        camera=view.camera,
        T_camera_target=transform(view.rotation, translation),
        covariance=covariance,
        pose=pose,
        reprojection=statistics,
        observability=Observability(
            focal_relative_uncertainty=focal_uncertainty,
            condition_number=result.condition_number,
            tilt=math.acos(min(1.0, max(-1.0, float(view.rotation[2, 2])))),
            prior_dominated=_prior_dominated(points, view.camera, covariance, lens) if len(indices) == len(FREE) else (),
        ),
        warnings=tuple(warnings),
        points=points,
        residuals_px=residuals,
        used=result.used,
    )


def _focal(camera: Camera, covariance: Float[np.ndarray, "15 15"]) -> tuple[float, float]:
    """Return the mean focal length and its relative standard uncertainty."""
    focal = 0.5 * (camera.fx_px + camera.fy_px)
    variance = 0.25 * float(covariance[0, 0] + 2.0 * covariance[0, 1] + covariance[1, 1])
    return focal, math.sqrt(max(variance, 0.0)) / focal


def _prior_dominated(
    points: GridPoints, camera: Camera, covariance: Float[np.ndarray, "15 15"], lens: Lens | None
) -> tuple[str, ...]:
    """Name the parameters of which the prior tells more than the image: posterior variance over half the prior's."""
    sigma = np.full(9, np.inf)
    sigma[2:4] = PRINCIPAL_POINT_PRIOR * points.image_width_px
    sigma[4:6] = RADIAL_PRIORS
    sigma[6:8] = TANGENTIAL_PRIOR
    if lens is not None:
        sigma[:2] = LENS_PRIOR * camera.fx_px, LENS_PRIOR * camera.fy_px
    dominated = np.diag(covariance)[:9] > 0.5 * sigma**2
    return tuple(name for name, flag in zip(CAMERA_PARAMETERS, dominated, strict=True) if flag)
