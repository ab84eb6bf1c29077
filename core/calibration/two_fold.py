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

Near the tilt at which the two minima merge there may be one alone, in a valley so flat that it may as well lie on the
wrong side: then the mirrored tilt itself, all else fitted, is the pose to be ruled out.

What is not ruled out is told, unless the pose's covariance holds it as its own doubt. A plane seen squarely has its two
tilts within the noise of one another: where the cost is as quadratic as the covariance takes it to be, the other tilt
lies d = √Λ standard deviations away. Where two valleys differ little, or are one flat one, d is greater, and the
covariance says too much against the other tilt once d² - Λ is beyond `COVERED`².

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
from core.calibration.view_residuals import descend, residuals_with_jacobian
from core.errors import Advisory
from core.targets.specification import GridPoints
from core.transforms import so3_exp, so3_log

FALSE_CHOICE = 1e-3
"""Probability with which a pose called certain may be the wrong one of the two, at the worst distance between them."""
STEPS, LONG_WAY = 12, 60
HOPELESS = 2.0
"""Times the evidence that rules a pose out: one further off is not worth a word."""
SHARE, LEAST = 1e-2, 1e-2
"""Of the excess over the first pose's cost, and of the noise's variance: steps that gain less are not taken."""
BACK = 0.5
"""Of the angle between the two tilts: a descent that ends nearer to the first pose than this went back toward it."""
COVERED = 2.0
"""Standard deviations by which a pose's covariance may say more against another pose than the residuals do."""


@dataclass(frozen=True, slots=True)
class SecondPose:
    """The other local minimum of a view: its state, the sums of squared residuals at the first minimum and at this one,
    and the `variance` s² of one of them at the first; all in stated uncertainties. Where there is none, it is the pose
    of the mirrored tilt, and not `is_minimum`.
    """

    view: View
    first_cost: float
    cost: float
    variance: float
    is_minimum: bool = True

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
    `used`, of which chance explains `variance` for each; or the pose of the mirrored tilt where the descent from there
    leads back, as it does for a plane seen squarely, or near and large. None where that is far from fitting.
    """
    start = View(view.parameters, mirrored(view.rotation, view.translation_mm), view.translation_mm)
    found, cost = _descended(points, start, used, STEPS, first_cost, LEAST * variance)
    if not math.isfinite(cost):
        return None
    if _tilt_between(found.rotation, view.rotation) > BACK * _tilt_between(start.rotation, view.rotation):
        return SecondPose(found, first_cost, cost, variance)
    held, cost = _at_its_tilt(points, start, used)
    second = SecondPose(held, first_cost, cost, variance, is_minimum=False)
    return second if second.evidence < HOPELESS * needed_evidence(math.inf) else None


def _at_its_tilt(points: GridPoints, start: View, used: Bool[np.ndarray, " n"]) -> tuple[View, float]:
    """Return the best pose of a start's tilt, to first order, and its Σ (residual/u)²: turned about the plane's normal,
    and moved.
    """
    root_weight = used / points.standard_uncertainty_px

    def weighed(R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
        residuals, jacobian = residuals_with_jacobian(
            np.ascontiguousarray(centred(points)[0].T),
            np.ascontiguousarray(points.points_px.T),
            start.parameters,
            np.ascontiguousarray(R),
            t,
            0,
        )
        return (residuals * root_weight).ravel(), (jacobian * root_weight).reshape(6, -1)

    normal = start.rotation[:, 2]
    r, J = weighed(start.rotation, start.translation_mm)
    along = np.vstack([normal @ J[:3], J[3:]])
    step = np.linalg.solve(along @ along.T, along @ r)
    view = View(start.parameters, so3_exp(step[0] * normal) @ start.rotation, start.translation_mm + step[1:])
    r, _ = weighed(view.rotation, view.translation_mm)
    return view, float(r @ r)


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


def is_held(other: SecondPose, view: View, information: Float[np.ndarray, "6 6"]) -> bool:
    """Tell whether a pose's covariance holds the other one as its own doubt; `information` is its inverse, of a small
    rotation about the points' centroid and a translation.
    """
    step = np.concatenate(
        [so3_log(other.view.rotation @ view.rotation.T), other.view.translation_mm - view.translation_mm]
    )
    return float(step @ information @ step) <= other.evidence * abs(other.evidence) + COVERED**2


def pose_ambiguous(ratio: float) -> Advisory:
    """Return the remark on an image that cannot tell its two poses apart."""
    return Advisory(
        "pose_ambiguous",
        "A second pose, tilted the opposite way, explains this image nearly as well (ratio of squared residuals "
        f"{ratio:.2f}): the pose reported is the better of the two, and may be the wrong one.",
        "Bring the camera nearer or use a larger board, so that it fills more of the image, and tilt it by 30° to 45°.",
    )
