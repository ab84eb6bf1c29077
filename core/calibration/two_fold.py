"""The other pose of a plane: its tilt mirrored about the line of sight, which a plane seen small or from afar hardly
tells from the true one.

Under weak perspective the image of a plane is the same for the tilts R and (I - 2 ℓℓᵀ) R diag(1, 1, -1), with ℓ the
direction in which the plane's middle is seen; only the convergence of its edges tells them apart. So the sum of squared
residuals has two minima, and a fit ends in that in whose valley it began. Both are looked at here, the camera held.

With c₁ and c₂ ≥ c₁ the sums at the better and the other minimum and s² the noise's variance, Λ = (c₂ - c₁)/s² is twice
the logarithm of their likelihoods' ratio. Were the other pose the true one, the two predictions a distance √λ apart in
units of the noise, then (c₁ - c₂)/s² would be normal about λ with the variance 4 λ, and as small as -Λ with a
probability of at most Φ(-√Λ), whatever λ. With s² itself from ν degrees of freedom Student's distribution takes the
normal one's place: the other pose is ruled out where √Λ exceeds its quantile.

References: G. Schweighofer, A. Pinz, "Robust pose estimation from a planar target", IEEE TPAMI 28 (2006), 2024-2030,
10.1109/TPAMI.2006.252; T. Collins, A. Bartoli, "Infinitesimal plane-based pose estimation", IJCV 109 (2014), 252-286,
10.1007/s11263-014-0725-5 (section 3: the second solution).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import stdtrit

from core.calibration.model import View, centred
from core.calibration.view_residuals import descend
from core.errors import Advisory
from core.targets.specification import GridPoints
from core.transforms import so3_log

FALSE_CHOICE = 1e-3
"""Probability with which a pose called certain may be the wrong one of the two, at the worst distance between them."""
STEPS, LONG_WAY = 12, 60
SHARE, LEAST = 1e-2, 1e-2
"""Of the excess over the first pose's cost, and of the noise's variance: steps that gain less are not taken."""
SAME = 1e-3
"""Of the angle between the two tilts: a descent that ends nearer to the first pose than this went back to it."""


@dataclass(frozen=True, slots=True)
class SecondPose:
    """The other local minimum of a view: its state, the sums of squared residuals at the first minimum and at this one,
    and the `variance` s² of one of them at the first; all in stated uncertainties.
    """

    view: View
    first_cost: float
    cost: float
    variance: float

    @property
    def ratio(self) -> float:
        """Return the lesser cost over the greater, 0 to 1: at 1 the image does not tell the two poses apart."""
        low, high = sorted((self.first_cost, self.cost))
        return low / high if high > 0.0 else 1.0

    @property
    def evidence(self) -> float:
        """Return √Λ, by how many standard deviations the first pose is the better; negative where the other is."""
        difference = (self.cost - self.first_cost) / self.variance
        return math.copysign(math.sqrt(abs(difference)), difference)


def mirrored(
    rotation: Float[np.ndarray, "*k 3 3"], translation_mm: Float[np.ndarray, "*k 3"]
) -> Float[np.ndarray, "*k 3 3"]:
    """Return (I - 2 ℓℓᵀ) R diag(1, 1, -1), ℓ = t/|t|: the same plane, its tilt mirrored about the line of sight."""
    sight = translation_mm / np.linalg.norm(translation_mm, axis=-1, keepdims=True)
    reflected = rotation - 2.0 * sight[..., :, None] * np.sum(
        sight[..., :, None] * rotation, axis=-2, keepdims=True
    )
    return np.asarray(reflected * np.array([1.0, 1.0, -1.0]))


def second_pose(
    points: GridPoints, view: View, used: Bool[np.ndarray, " n"], first_cost: float, variance: float
) -> SecondPose | None:
    """Return the other local minimum beside `view`, itself one with Σ (residual/u)² = `first_cost` over the points
    `used`, of which chance explains `variance` for each; None where there is none: where the descent from the mirrored
    tilt leads back, as it does for a plane seen squarely, or near and large.
    """
    start = View(view.parameters, mirrored(view.rotation, view.translation_mm), view.translation_mm)
    found, cost = _descended(points, start, used, STEPS, first_cost, LEAST * variance)
    back = _tilt_between(found.rotation, view.rotation) <= SAME * _tilt_between(start.rotation, view.rotation)
    if back or not math.isfinite(cost):
        return None
    return SecondPose(found, first_cost, cost, variance)


def better_start(points: GridPoints, view: View) -> View:
    """Return the better of the minima below `view` and below its mirrored tilt, over all points.

    Where perspective hardly shows, a homography's pose lies anywhere, at times on the saddle between the two.
    """
    everything = np.ones(len(points), dtype=np.bool_)
    tilts = (view.rotation, mirrored(view.rotation, view.translation_mm))
    found = [
        _descended(points, View(view.parameters, R, view.translation_mm), everything, LONG_WAY, math.inf, 0.0)
        for R in tilts
    ]
    return min(found, key=lambda one: one[1])[0]


def _descended(
    points: GridPoints, start: View, used: Bool[np.ndarray, " n"], steps: int, known_cost: float, least: float
) -> tuple[View, float]:
    """Return the state and the cost at the end of a descent with the camera held."""
    rotation, translation, cost = descend(
        np.ascontiguousarray(centred(points)[0].T),
        np.ascontiguousarray(points.points_px.T),
        used / points.standard_uncertainty_px,
        start.parameters,
        np.ascontiguousarray(start.rotation),
        start.translation_mm,
        steps,
        known_cost,
        SHARE,
        least,
    )
    return View(start.parameters, rotation, translation), float(cost)


def _tilt_between(one: Float[np.ndarray, "3 3"], other: Float[np.ndarray, "3 3"]) -> float:
    """Return the angle between the planes' normals, rad; by their chord, which is exact for small ones."""
    return 2.0 * math.asin(min(1.0, 0.5 * math.dist(one[:, 2].tolist(), other[:, 2].tolist())))


def needed_evidence(degrees_of_freedom: float) -> float:
    """Return the √Λ from which on the other pose is ruled out: Student's quantile at 1 - `FALSE_CHOICE`."""
    return float(stdtrit(max(degrees_of_freedom, 1.0), 1.0 - FALSE_CHOICE))


def apart(other: SecondPose, view: View, information: Float[np.ndarray, "6 6"]) -> float:
    """Return how many of its standard deviations the pose would have to be off to be the other one; `information` is
    its inverse covariance, of a small rotation about the points' centroid and a translation.

    A plane seen squarely has its two tilts within the noise of one another: what the pose's covariance covers is no
    second pose.
    """
    step = np.concatenate(
        [so3_log(other.view.rotation @ view.rotation.T), other.view.translation_mm - view.translation_mm]
    )
    return math.sqrt(max(float(step @ information @ step), 0.0))


def pose_ambiguous(ratio: float) -> Advisory:
    """Return the remark on an image that cannot tell its two poses apart."""
    return Advisory(
        "pose_ambiguous",
        "A second pose, tilted the opposite way, explains this image nearly as well (ratio of squared residuals "
        f"{ratio:.2f}): the pose reported is the better of the two, and may be the wrong one.",
        "Bring the camera nearer or use a larger board, so that it fills more of the image, and tilt it by 30° to 45°.",
    )
