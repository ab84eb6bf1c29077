"""The value a calibration returns: estimate, covariance, residuals and warnings.

State order of every full covariance: the camera's nine parameters (`CAMERA_PARAMETERS`), then a small
rotation w and a small translation d of T_camera_target, with R_true = exp(w) R and t_true = t + d, in the
camera frame (rad, mm).

Grade of an image and the 95 % interval of its focal length f:

One view separates f from depth by the convergence of lines against their foreshortening. Where the convergence is what
noise blurs, the likelihood is nearly Gaussian in 1/f², and the interval longer toward long focal lengths; in the weak
views that occur, seen at 2° to 14°, it is the foreshortening, and the profile of the likelihood is nearly Gaussian in
f², longer toward short ones. The best f lies below the middle of what is probable by a third to a half of u(f) there,
for more combinations of tilt and f explain the image on the long side. Together they leave log f nearly Gaussian about
the best f, in which the interval is taken:

    f exp(-z r)  to  f exp(z r),      z = 1.96, r = u(f)/f.

An answer is given while the profile's interval, too, stays within a factor `MAX_INTERVAL_FACTOR` of f: the longer side
of both shapes reaches f / √(1 - 2 z r) or f √(1 - 2 z r), so r is at most (1 - 1/factor²)/(2 z) = 14 %. Beyond it that
side grows fast, and from 1/(2 z) = 26 % it has no end. `benchmarks/images/grades.py` measures what the intervals hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.errors import Advisory
from core.geometry import Camera
from core.numerics import NORMAL_95
from core.targets import GridPoints

MAX_DETERMINED_UNCERTAINTY = 0.02
"""Largest u(f)/f of an image that determines the camera by itself."""
MAX_INTERVAL_FACTOR = 1.5
"""Largest factor between f and either end of its 95 % interval that is reported at all."""
MAX_FOCAL_UNCERTAINTY = (1.0 - MAX_INTERVAL_FACTOR**-2) / (2.0 * NORMAL_95)
"""Largest u(f)/f that is reported at all, 14 %; beyond it a view is refused."""


def grade(relative_uncertainty: float) -> str:
    """Return "determined" or "weak" for an image's u(f)/f."""
    return "determined" if relative_uncertainty <= MAX_DETERMINED_UNCERTAINTY else "weak"


def focal_relative_uncertainty(covariance: Float[np.ndarray, "p p"], fx_px: float, fy_px: float) -> float:
    """Return u(f)/f, f the mean of fx and fy, whose covariance comes first."""
    variance = 0.25 * float(covariance[0, 0] + 2.0 * covariance[0, 1] + covariance[1, 1])
    return math.sqrt(max(variance, 0.0)) / (0.5 * (fx_px + fy_px))


def focal_weakly_observable(who: str, relative_uncertainty: float, advice: str) -> Advisory:
    """Return the warning of what answers, but does not determine the focal length; `who` begins its sentence."""
    return Advisory(
        "focal_weakly_observable",
        f"{who} the focal length uncertain by {100.0 * relative_uncertainty:.1f} %, more than "
        f"{100.0 * MAX_DETERMINED_UNCERTAINTY:g} %; the camera's distance is uncertain by as much.",
        advice,
    )


def focal_interval(focal_px: float, standard_uncertainty_px: float) -> tuple[float, float]:
    """Return the 95 % interval of a focal length, px; f itself twice where it was given."""
    factor = math.exp(NORMAL_95 * standard_uncertainty_px / focal_px)
    return focal_px / factor, focal_px * factor


@dataclass(frozen=True, slots=True)
class CameraPose:
    """The camera in the target frame (the paper's eqs 36-37): p = -Rᵀt, R_ee = Rᵀ.

    `covariance` (6, 6): x, y, z in mm, then a small rotation w in rad with R_true = exp(w) R_estimated, all
    in the target frame. `covariance_given_camera` is the same with the intrinsics held fixed. Angles in
    radians, R = Rz(yaw) Ry(pitch) Rx(roll).
    """

    position_mm: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    roll_pitch_yaw: Float[np.ndarray, "3"]
    roll_pitch_yaw_standard_uncertainty: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "6 6"]
    covariance_given_camera: Float[np.ndarray, "6 6"]


@dataclass(frozen=True, slots=True)
class Reprojection:
    """Statistics of the 2-D residual distances of the points used, px; the rms is over points."""

    rms_px: float
    mean_px: float
    std_px: float
    max_px: float
    points: int
    rejected: int


@dataclass(frozen=True, slots=True)
class Observability:
    """How well the view determines the state.

    `focal_relative_uncertainty` is the predicted u(f)/f; `condition_number` that of the scaled normal matrix;
    `tilt` the angle (rad) between the optical axis and the target's normal; `prior_dominated` names the
    parameters whose uncertainty is mostly the prior's. `ambiguity_log_likelihood_ratio` is the log-likelihood of the
    pose less that of the second local minimum, whose tilt is mirrored about the line of sight: near 0 the two poses
    cannot be distinguished; None without a second minimum, unless the warning `pose_ambiguous` is about the mirrored
    tilt itself.
    """

    focal_relative_uncertainty: float
    condition_number: float
    tilt: float
    prior_dominated: tuple[str, ...]
    ambiguity_log_likelihood_ratio: float | None = None


@dataclass(frozen=True, slots=True)
class Calibration:
    """One image, calibrated."""

    estimator: str  # per_image | given
    initialisation: str  # nullspace | vanishing_point | nominal
    image_width_px: int
    image_height_px: int
    camera: Camera
    T_camera_target: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "15 15"]
    pose: CameraPose
    reprojection: Reprojection
    observability: Observability
    warnings: tuple[Advisory, ...]
    points: GridPoints
    residuals_px: Float[np.ndarray, "n 2"]  # observed - predicted, one row per grid point, rejected ones too
    used: Bool[np.ndarray, " n"]
    inflation: float  # of the standard uncertainties, beyond what independent residuals call for

    @property
    def grade(self) -> str:
        """Return "determined" or "weak": whether the image determines the focal length by itself (`grade`)."""
        return grade(self.observability.focal_relative_uncertainty)

    @property
    def focal_interval_95(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the 95 % intervals of fx and fy, px: longer above than below; of no length where f was given."""
        fx, fy = self.camera_standard_uncertainty[:2].tolist()
        return focal_interval(self.camera.fx_px, fx), focal_interval(self.camera.fy_px, fy)

    @property
    def camera_standard_uncertainty(self) -> Float[np.ndarray, "9"]:
        """Standard uncertainties in the order of `CAMERA_PARAMETERS`; 0 where a parameter was held fixed."""
        variances: Float[np.ndarray, "9"] = np.diag(self.covariance)[:9]
        return np.sqrt(variances)
