"""Priors on cameras: what lenses and sensors are like, and what a user states of a lens.

With one planar view they are what separates focal length and principal point from depth. The widths are those of
published multi-view calibrations (docs/method.md; section priors of benchmarks/RESULTS.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.calibration.residuals import View
from core.calibration.state import FREE
from core.errors import InvalidArgument
from core.geometry import CAMERA_PARAMETERS, KannalaBrandtCamera, RationalCamera, camera_from_array
from core.numerics import Prior
from core.targets import GridPoints

LENS_PRIOR = 0.05
"""Relative standard uncertainty of a focal length computed from the lens's engraving and the pixel pitch."""
FOCAL_PRIOR = math.log(0.8), 0.6
"""Mean and standard deviation of log(f / the image's longer side): what lenses are, where none is stated."""
PRINCIPAL_POINT_PRIOR = 0.019
"""Of the image's longer side, about the centre: what two published calibrations of one kind of camera have in common,
as root mean square, so that their own noise averages out. The same of p1 and p2 is `TANGENTIAL_PRIOR`.
"""
ASPECT_PRIOR = 2.5e-3
"""Of fx/fy about 1. What images show of it is the sensor's pixels and the print's length against its width together: of
409 published calibrations with Brown's model, each repository counted once, log fx/fy has a Student's t with this
scale and heavier tails than the normal distribution. A prior of 1e-3 left 54 % of them outside its 95 %.
"""
TANGENTIAL_PRIOR = 2e-3
RADIAL_PRIORS = (0.3, 0.5)
RATIONAL_PRIORS = {"k1": 0.3, "k2": 0.5, "k3": 0.5, "k4": 1.0, "k5": 0.5, "k6": 0.5}
CURVATURE_ANGLES = (0.3, 0.55, 0.8, 1.0)
"""Of the corner's angle: where κ(θ) = (ρ/θ - 1)/θ² has its prior, with Kannala's and Brandt's model. The coefficients
themselves are no measure of a lens, they cancel one another; κ is 1/3 in perspective and 0 for an equidistant lens.
"""
CURVATURE_MEANS = (0.20, 0.207, 0.213, 0.22)
CURVATURE_PRIORS = (0.15, 0.04, 0.05, 0.08)
"""Standard deviations of κ at the first angle, and of its increments."""
MAX_CORNER_ANGLE = 1.5  # rad

CameraPrior = Callable[[Float[np.ndarray, " s"]], tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]]


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


def camera_prior(
    width_px: int,
    height_px: int,
    lens: Lens | None,
    coordinates: int | None = None,
    model_size: int = len(CAMERA_PARAMETERS),
) -> CameraPrior:
    """Gaussian priors on a camera's parameters, in their σ; those on log(fx/fy) and log f are scale-free.

    The last is that of the stated `lens`, or a weak one. Derivatives are by `coordinates` of a step, the camera's free
    ones first; None is these alone. `model_size` is the number of parameters of the lens model
    (`core.geometry.LENS_PARAMETERS`): models beyond Brown's have priors of their own on the radius (`wide_lens_prior`).
    """
    centre = 0.5 * (width_px - 1), 0.5 * (height_px - 1)
    longer = max(width_px, height_px)
    sigma_centre = PRINCIPAL_POINT_PRIOR * longer
    log_focal, sigma_focal = (
        (math.log(longer) + FOCAL_PRIOR[0], FOCAL_PRIOR[1])
        if lens is None
        else (math.log(lens.focal_px), LENS_PRIOR)
    )
    if model_size != len(CAMERA_PARAMETERS):
        return wide_lens_prior((width_px, height_px), (log_focal, sigma_focal), model_size)
    constant = np.zeros((8, 8 if coordinates is None else coordinates))
    constant[0, 2] = constant[1, 3] = 1.0 / sigma_centre
    constant[2, 4], constant[3, 5] = 1.0 / RADIAL_PRIORS[0], 1.0 / RADIAL_PRIORS[1]
    constant[4, 6] = constant[5, 7] = 1.0 / TANGENTIAL_PRIOR

    def prior(
        parameters: Float[np.ndarray, " s"],
    ) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]:
        fx, fy, cx, cy, k1, k2, p1, p2 = parameters.tolist()[:8]
        q, Q = np.empty(8), constant.copy()
        q[0], q[1] = (centre[0] - cx) / sigma_centre, (centre[1] - cy) / sigma_centre
        q[2], q[3] = -k1 / RADIAL_PRIORS[0], -k2 / RADIAL_PRIORS[1]
        q[4], q[5] = -p1 / TANGENTIAL_PRIOR, -p2 / TANGENTIAL_PRIOR
        q[6] = -math.log(fx / fy) / ASPECT_PRIOR
        Q[6, 0], Q[6, 1] = 1.0 / (fx * ASPECT_PRIOR), -1.0 / (fy * ASPECT_PRIOR)
        q[7] = (log_focal - 0.5 * math.log(fx * fy)) / sigma_focal
        Q[7, 0], Q[7, 1] = 0.5 / (fx * sigma_focal), 0.5 / (fy * sigma_focal)
        return q, Q

    return prior


def wide_lens_prior(size_px: tuple[int, int], log_focal: tuple[float, float], model_size: int) -> CameraPrior:
    """Return the priors on a camera of a model beyond Brown's, with their derivatives by its parameters, in their σ.

    `size_px` is that of the image, `log_focal` mean and standard deviation of log f, `model_size` the number of the
    model's parameters.
    """
    centre = 0.5 * (size_px[0] - 1), 0.5 * (size_px[1] - 1)
    sigma_centre = PRINCIPAL_POINT_PRIOR * max(size_px)
    corner_px = math.hypot(*centre)

    def prior(
        parameters: Float[np.ndarray, " s"],
    ) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]:
        camera = camera_from_array(parameters)
        fx, fy = camera.fx_px, camera.fy_px
        q, Q = np.zeros(6), np.zeros((6, model_size))
        q[0], q[1] = (centre[0] - camera.cx_px) / sigma_centre, (centre[1] - camera.cy_px) / sigma_centre
        Q[0, 2] = Q[1, 3] = 1.0 / sigma_centre
        q[2] = -math.log(fx / fy) / ASPECT_PRIOR
        Q[2, 0], Q[2, 1] = 1.0 / (fx * ASPECT_PRIOR), -1.0 / (fy * ASPECT_PRIOR)
        q[3] = (log_focal[0] - 0.5 * math.log(fx * fy)) / log_focal[1]
        Q[3, 0], Q[3, 1] = 0.5 / (fx * log_focal[1]), 0.5 / (fy * log_focal[1])
        tangential = 8 if isinstance(camera, KannalaBrandtCamera) else 6
        q[4], q[5] = -camera.p1 / TANGENTIAL_PRIOR, -camera.p2 / TANGENTIAL_PRIOR
        Q[4, tangential] = Q[5, tangential + 1] = 1.0 / TANGENTIAL_PRIOR
        if isinstance(camera, KannalaBrandtCamera):
            radial, by_parameter = _of_curvature(camera, corner_px)
        else:
            assert isinstance(camera, RationalCamera)
            radial, by_parameter = _of_rational(camera)
        return np.concatenate([q, radial]), np.vstack([Q, by_parameter])

    return prior


def _of_curvature(
    camera: KannalaBrandtCamera, corner_px: float
) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4 10"]]:
    corner = corner_px / math.sqrt(camera.fx_px * camera.fy_px)
    theta = np.array(CURVATURE_ANGLES) * min(corner, MAX_CORNER_ANGLE)
    powers = theta[:, None] ** np.array([0, 2, 4, 6])
    k = np.array([camera.k1, camera.k2, camera.k3, camera.k4])
    by = np.zeros((4, 10))
    by[:, 4:8] = powers
    if corner < MAX_CORNER_ANGLE:  # the angles shrink as f grows
        along = theta * (2.0 * k[1] * theta + 4.0 * k[2] * theta**3 + 6.0 * k[3] * theta**5)
        by[:, 0], by[:, 1] = -0.5 * along / camera.fx_px, -0.5 * along / camera.fy_px
    off = np.array(CURVATURE_MEANS) - powers @ k
    q = np.concatenate([off[:1], np.diff(off)]) / CURVATURE_PRIORS
    Q = np.vstack([by[:1], np.diff(by, axis=0)]) / np.array(CURVATURE_PRIORS)[:, None]
    return q, Q


def _of_rational(camera: RationalCamera) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 12"]]:
    q, Q = np.empty(6), np.zeros((6, 12))
    for row, (name, place) in enumerate(zip(RATIONAL_PRIORS, (4, 5, 8, 9, 10, 11), strict=True)):
        q[row] = -getattr(camera, name) / RATIONAL_PRIORS[name]
        Q[row, place] = 1.0 / RATIONAL_PRIORS[name]
    return q, Q


def view_prior(points: GridPoints, lens: Lens | None, factor: float = 1.0) -> Prior[View]:
    """`camera_prior` over the step of one free view, its residuals times `factor`.

    Where the data's uncertainties are larger by a factor than a fit takes them to be, and the whole covariance is
    multiplied by its square afterwards, priors that count by the same factor more keep their stated width.
    """
    of_camera = camera_prior(points.image_width_px, points.image_height_px, lens, len(FREE))

    def prior(view: View) -> tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]:
        q, Q = of_camera(view.parameters)
        return factor * q, factor * Q

    return prior
