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
from core.calibration.view_residuals import residuals_with_jacobian
from core.camera import Camera
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
    cameras = len(FREE) - len(POSE) if free else 0
    target, observed = np.ascontiguousarray(centred(points)[0].T), np.ascontiguousarray(points.points_px.T)

    def evaluate(view: View) -> tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "p 2 n"]]:
        return residuals_with_jacobian(
            target, observed, view.parameters, view.rotation, view.translation_mm, cameras
        )

    return evaluate


def retract_pose(view: View, step: Float[np.ndarray, "6"]) -> View:
    return View(view.parameters, so3_exp(step[:3]) @ view.rotation, view.translation_mm + step[3:])


def retract(view: View, step: Float[np.ndarray, "14"]) -> View:
    """Move along a curve with tangent `step` that follows the valley of one-image calibration.

    Under weak perspective the image hardly changes while f, depth and tilt grow in proportion, k1 with f² and
    k2 with f⁴. A straight step leaves that curved valley at second order and the solver creeps; this curve
    stays in it. Its tangent is the plain step's, so Jacobian and covariance are untouched.
    """
    # Numbers one by one: arrays of three would cost ten times as much.
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = view.parameters.tolist()
    dfx, dfy, dcx, dcy, dk1, dk2, dp1, dp2, wx, wy, wz, dx, dy, dz = step.tolist()
    X, Y, Z = view.translation_mm.tolist()
    ratio = _bounded(0.5 * (dfx / fx + dfy / fy))
    growth = math.expm1(ratio) / ratio if abs(ratio) > 1e-8 else 1.0
    new_fx, new_fy, new_Z = (
        value * math.exp(_bounded(d / value)) for value, d in ((fx, dfx), (fy, dfy), (Z, dz))
    )
    k1 += dk1 + k1 * (math.expm1(2.0 * ratio) - 2.0 * ratio)
    k2 += dk2 + k2 * (math.expm1(4.0 * ratio) - 4.0 * ratio)
    # The centroid's image f·x/z + c keeps its first-order motion, however far f and depth go.
    x, y = X / Z, Y / Z
    image_x = fx * x + dfx * x + fx * (dx - x * dz) / Z
    image_y = fy * y + dfy * y + fy * (dy - y * dz) / Z
    parameters = np.array([new_fx, new_fy, cx + dcx, cy + dcy, k1, k2, p1 + dp1, p2 + dp2, k3])
    translation = np.array([image_x / new_fx * new_Z, image_y / new_fy * new_Z, new_Z])
    rotation = so3_exp(np.array([wx * growth, wy * growth, wz * growth])) @ view.rotation
    return View(parameters, rotation, translation)


def _bounded(logarithm: float) -> float:
    """A change of a length by a factor of two at most in one step."""
    return min(max(logarithm, -0.7), 0.7)


def camera_prior(
    width_px: int, height_px: int, lens: Lens | None, coordinates: int = 8
) -> Callable[[Float[np.ndarray, "9"]], tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]]:
    """Gaussian priors on a camera's parameters, in their σ; those on log(fx/fy) and log f are scale-free.

    Derivatives are by `coordinates` of a step, the camera's eight first.
    """
    centre = 0.5 * (width_px - 1), 0.5 * (height_px - 1)
    sigma_centre = PRINCIPAL_POINT_PRIOR * width_px
    rows = 7 + (lens is not None)
    constant = np.zeros((rows, coordinates))
    constant[0, 2] = constant[1, 3] = 1.0 / sigma_centre
    constant[2, 4], constant[3, 5] = 1.0 / RADIAL_PRIORS[0], 1.0 / RADIAL_PRIORS[1]
    constant[4, 6] = constant[5, 7] = 1.0 / TANGENTIAL_PRIOR

    def prior(parameters: Float[np.ndarray, "9"]) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]:
        fx, fy, cx, cy, k1, k2, p1, p2 = parameters.tolist()[:8]
        q, Q = np.empty(rows), constant.copy()
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
    of_camera = camera_prior(points.image_width_px, points.image_height_px, lens, len(FREE))
    return lambda view: of_camera(view.parameters)


def image_centre(points: GridPoints) -> tuple[float, float]:
    """The image's middle in pixel-centre coordinates."""
    return 0.5 * (points.image_width_px - 1), 0.5 * (points.image_height_px - 1)


def view_of(start: ClosedForm, points: GridPoints) -> View:
    rotation = start.T_camera_target[:3, :3]
    centroid = rotation @ centred(points)[1] + start.T_camera_target[:3, 3]
    return View(start.camera.as_array(), rotation, centroid)
