"""The state of a view and what fits share: residuals with derivatives, curved steps, and priors on cameras.

State: the camera's nine parameters (k3 held at the start's value) and T_camera_target with a left
perturbation, R ← exp(w) R, t ← t + d. The priors say what lenses and sensors are like; with one planar view
they are what separates focal length and principal point from depth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.calibration.closed_form import ClosedForm
from core.camera import Camera, project_with_jacobian
from core.errors import InvalidArgument
from core.least_squares import Evaluate, Prior
from core.targets.specification import GridPoints
from core.transforms import so3_exp

LENS_PRIOR = 0.05
"""Relative standard uncertainty of a focal length computed from the lens's engraving and the pixel pitch."""
PRINCIPAL_POINT_PRIOR = 0.01  # of the image width, about the centre
ASPECT_PRIOR = 1e-3
TANGENTIAL_PRIOR = 3e-4
SMALLEST_NOISE_PX = (
    1e-4  # no camera locates corners better; exact points still need the priors to separate f from depth
)
RADIAL_PRIORS = (0.3, 0.5)

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
    points' centroid in the camera frame (mm): turning about the centroid decouples rotation from translation.
    """

    parameters: Float[np.ndarray, "9"]
    rotation: Float[np.ndarray, "3 3"]
    translation_mm: Float[np.ndarray, "3"]

    @property
    def camera(self) -> Camera:
        return Camera.from_array(self.parameters)


def centred(points: GridPoints) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "3"]]:
    """Return the grid points about their centroid, and the centroid (target frame, mm)."""
    target = points.points_target
    centroid = target.mean(axis=0)
    return target - centroid, centroid


def view_residuals(points: GridPoints, *, free: bool) -> Evaluate[View]:
    """Return the residual function over `FREE` step coordinates, or over those of the `POSE` alone."""
    first = len(FREE) - len(POSE) if free else 0
    target, observed = centred(points)[0], points.points_px.T

    def evaluate(view: View) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
        rotated = target @ view.rotation.T  # about the centroid
        pixels, by_camera, by_point = project_with_jacobian(rotated + view.translation_mm, view.camera)
        X, Y, Z = rotated.T
        jacobian = np.empty((first + 6, 2, len(target)))
        jacobian[:first] = by_camera[:first]
        # d(exp(w) R x)/dw = w × (R x), one axis at a time.
        jacobian[first] = by_point[2] * Y - by_point[1] * Z
        jacobian[first + 1] = by_point[0] * Z - by_point[2] * X
        jacobian[first + 2] = by_point[1] * X - by_point[0] * Y
        jacobian[first + 3 :] = by_point
        return observed - pixels, jacobian

    return evaluate


def retract_pose(view: View, step: Float[np.ndarray, "6"]) -> View:
    return View(view.parameters, so3_exp(step[:3]) @ view.rotation, view.translation_mm + step[3:])


def retract(view: View, step: Float[np.ndarray, "14"]) -> View:
    """Move along a curve with tangent `step` that follows the valley of one-image calibration.

    Under weak perspective the image hardly changes while f, depth and tilt grow in proportion, k1 with f² and
    k2 with f⁴. A straight step leaves that curved valley at second order and the solver creeps; this curve
    stays in it. Its tangent is the plain step's, so Jacobian and covariance are untouched.
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


def camera_prior(
    width_px: int, height_px: int, lens: Lens | None
) -> Callable[[Float[np.ndarray, "9"]], tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q 8"]]]:
    """Gaussian priors on a camera's parameters, in their σ; those on log(fx/fy) and log f are scale-free."""
    centre = 0.5 * (width_px - 1), 0.5 * (height_px - 1)
    sigma_centre = PRINCIPAL_POINT_PRIOR * width_px
    rows = 7 + (lens is not None)
    Q = np.zeros((rows, 8))
    Q[0, 2] = Q[1, 3] = 1.0 / sigma_centre
    Q[2, 4], Q[3, 5] = 1.0 / RADIAL_PRIORS[0], 1.0 / RADIAL_PRIORS[1]
    Q[4, 6] = Q[5, 7] = 1.0 / TANGENTIAL_PRIOR

    def prior(parameters: Float[np.ndarray, "9"]) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q 8"]]:
        fx, fy, cx, cy, k1, k2, p1, p2 = parameters.tolist()[:8]
        q = np.empty(rows)
        q[0], q[1] = (centre[0] - cx) / sigma_centre, (centre[1] - cy) / sigma_centre
        q[2], q[3] = -k1 / RADIAL_PRIORS[0], -k2 / RADIAL_PRIORS[1]
        q[4], q[5] = -p1 / TANGENTIAL_PRIOR, -p2 / TANGENTIAL_PRIOR
        q[6] = -math.log(fx / fy) / ASPECT_PRIOR
        Q[6, 0], Q[6, 1] = 1.0 / (fx * ASPECT_PRIOR), -1.0 / (fy * ASPECT_PRIOR)
        if lens is not None:
            q[7] = math.log(lens.focal_px / math.sqrt(fx * fy)) / LENS_PRIOR
            Q[7, 0], Q[7, 1] = 0.5 / (fx * LENS_PRIOR), 0.5 / (fy * LENS_PRIOR)
        return q, Q

    return prior


def view_prior(points: GridPoints, lens: Lens | None) -> Prior[View]:
    """`camera_prior` over the step of one free view."""
    of_camera = camera_prior(points.image_width_px, points.image_height_px, lens)

    def prior(view: View) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]:
        q, Q = of_camera(view.parameters)
        padded = np.zeros((len(q), len(FREE)))
        padded[:, :8] = Q
        return q, padded

    return prior


def image_centre(points: GridPoints) -> tuple[float, float]:
    """The image's middle in pixel-centre coordinates."""
    return 0.5 * (points.image_width_px - 1), 0.5 * (points.image_height_px - 1)


def view_of(start: ClosedForm, points: GridPoints) -> View:
    rotation = start.T_camera_target[:3, :3]
    centroid = rotation @ centred(points)[1] + start.T_camera_target[:3, 3]
    return View(start.camera.as_array(), rotation, centroid)
