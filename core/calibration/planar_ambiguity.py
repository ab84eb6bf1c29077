"""Two-fold ambiguity of a plane's pose: the tilt mirrored about the line of sight may fit nearly as well.

Under weak perspective the image of a plane is the same for the tilts R and (I - 2 ℓℓᵀ) R diag(1, 1, -1), with ℓ the
direction in which the plane's middle is seen; only the convergence of its edges separates them. So the sum of squared
residuals has two minima, and a fit ends in that in whose valley it began. Both are looked at here, the camera held.

With c₁ and c₂ ≥ c₁ the sums at the better and the other minimum and s² the noise's variance, Λ = (c₂ - c₁)/s² is twice
the logarithm of their likelihoods' ratio. Were the other pose the true one, the two predictions a distance √λ apart in
units of the noise, then (c₁ - c₂)/s² would be normal about λ with the variance 4 λ, and as small as -Λ with a
probability of at most Φ(-√Λ), whatever λ. With s² itself from ν degrees of freedom Student's distribution takes the
normal one's place: the other pose is ruled out where √Λ exceeds its quantile.

Near the tilt at which the two minima merge there may be one alone, in a valley so flat that it may as well lie on the
wrong side: then the mirrored tilt itself, all else fitted, is the pose to be ruled out.

A second pose that is not ruled out is reported, except where the pose's own covariance already covers it. A plane
seen squarely has its two tilts within the noise of one another: where the cost is as quadratic as the covariance
takes it to be, the other tilt lies d = √Λ standard deviations away. Where two valleys differ little, or are one flat
one, d is greater, and the covariance says too much against the other tilt once d² - Λ is beyond `COVERAGE_SIGMAS`².

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

from core.calibration.priors import Lens, view_prior
from core.calibration.residuals import View, descend, residuals_with_jacobian
from core.calibration.state import centred
from core.errors import ADVISED_TILT, Advisory
from core.geometry import so3_exp, so3_log
from core.numerics import Fit
from core.targets import GridPoints

FALSE_CHOICE = 1e-3
"""Probability with which a pose called certain may be the wrong one of the two, at the worst distance between them."""
STEPS, LONG_WAY = 12, 60
MAX_EVIDENCE_RATIO = 2.0
"""Times the evidence that rules a pose out: one further off is not worth a word."""
MIN_RELATIVE_GAIN, LEAST = 1e-2, 1e-2
"""Of the excess over the first pose's cost, and of the noise's variance: steps that gain less are not taken."""
RETURN_SHARE = 0.5
"""Of the angle between the two tilts: a descent that ends nearer to the first pose than this went back toward it."""
COVERAGE_SIGMAS = 2.0
"""Standard deviations by which a pose's covariance may say more against another pose than the residuals do."""


@dataclass(frozen=True, slots=True)
class SecondPose:
    """The other local minimum of a view: its state, the sums of squared residuals at the first minimum and at this one,
    and the `variance` s² of one of them at the first; all in stated uncertainties. Without a second minimum it is the
    pose of the mirrored tilt, and not `is_minimum`.
    """

    view: View
    first_cost: float
    cost: float
    variance: float
    is_minimum: bool = True

    @property
    def ratio(self) -> float:
        """Return the lesser cost over the greater, 0 to 1: at 1 the image does not separate the two poses."""
        low, high = sorted((self.first_cost, self.cost))
        return low / high if high > 0.0 else 1.0

    @property
    def log_likelihood_ratio(self) -> float:
        """Return Λ/2, the first pose's log-likelihood less the other's; negative where the other is the likelier."""
        return 0.5 * (self.cost - self.first_cost) / self.variance

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
    """Return the other local minimum than `view`, which is itself one with Σ (residual/u)² = `first_cost` over the
    points `used`, of which chance explains `variance` for each; or the pose of the mirrored tilt where the descent
    from there leads back, as it does for a plane seen squarely, or near and large. None where that is far from
    fitting.
    """
    start = View(view.parameters, mirrored(view.rotation, view.translation_mm), view.translation_mm)
    found, cost = _descended(points, start, used, STEPS, first_cost, LEAST * variance)
    if not math.isfinite(cost):
        return None
    if _tilt_between(found.rotation, view.rotation) > RETURN_SHARE * _tilt_between(
        start.rotation, view.rotation
    ):
        return SecondPose(found, first_cost, cost, variance)
    held, cost = _at_its_tilt(points, start, used)
    second = SecondPose(held, first_cost, cost, variance, is_minimum=False)
    return second if second.evidence < MAX_EVIDENCE_RATIO * needed_evidence(math.inf) else None


def is_nearer_to_first(view: View, first: View, other: View) -> bool:
    """Return whether a fit that began at the other tilt ended at the first."""
    return float(view.rotation[:, 2] @ first.rotation[:, 2]) > float(
        view.rotation[:, 2] @ other.rotation[:, 2]
    )


def second_of_two_fits(
    points: GridPoints, best: Fit[View], second: Fit[View], lens: Lens | None, inflation: float
) -> SecondPose:
    """Return the second of two free fits, over the points of the first; what priors say of each camera counts too."""
    prior, uncertainty = view_prior(points, lens), points.standard_uncertainty_px
    used = best.used & second.used
    variance = (inflation * best.scale / float(np.mean(uncertainty))) ** 2
    costs = []
    for result in (best, second):
        q, _ = prior(result.state)
        squares = float(np.sum((result.residuals[:, used] / uncertainty[used]) ** 2))
        costs.append(squares + variance * float(q @ q))
    return SecondPose(second.state, costs[0], costs[1], variance)


def _at_its_tilt(points: GridPoints, start: View, used: Bool[np.ndarray, " n"]) -> tuple[View, float]:
    """Return the best pose of a start's tilt, to first order, and its Σ (residual/u)²: turned about the plane's normal,
    and moved.
    """
    root_weight = used / points.standard_uncertainty_px

    def weighed(R: Float[np.ndarray, "3 3"], t: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
        residuals, jacobian = residuals_with_jacobian(
            np.ascontiguousarray(centred(points)[0].T),
            np.ascontiguousarray(points.points_px.T),
            View(start.parameters, R, t),
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
    return descend(
        np.ascontiguousarray(centred(points)[0].T),
        np.ascontiguousarray(points.points_px.T),
        used / points.standard_uncertainty_px,
        start,
        steps,
        known_cost=known_cost,
        share=MIN_RELATIVE_GAIN,
        least=least,
    )


def _tilt_between(one: Float[np.ndarray, "3 3"], other: Float[np.ndarray, "3 3"]) -> float:
    """Return the angle between the planes' normals, rad; by their chord, which is exact for small ones."""
    return 2.0 * math.asin(min(1.0, 0.5 * math.dist(one[:, 2].tolist(), other[:, 2].tolist())))


def needed_evidence(degrees_of_freedom: float) -> float:
    """Return the √Λ from which on the other pose is ruled out: Student's quantile at 1 - `FALSE_CHOICE`."""
    return float(stdtrit(max(degrees_of_freedom, 1.0), 1.0 - FALSE_CHOICE))


def is_covered(other: SecondPose, view: View, information: Float[np.ndarray, "6 6"]) -> bool:
    """Return whether a pose's covariance covers the other pose; `information` is its inverse, of a small
    rotation about the points' centroid and a translation.
    """
    step = np.concatenate(
        [so3_log(other.view.rotation @ view.rotation.T), other.view.translation_mm - view.translation_mm]
    )
    return float(step @ information @ step) <= other.evidence * abs(other.evidence) + COVERAGE_SIGMAS**2


def pose_ambiguous(ratio: float) -> Advisory:
    """Return the warning for an image that does not separate its two poses."""
    return Advisory(
        "pose_ambiguous",
        "A second pose, tilted the opposite way, explains this image nearly as well (ratio of squared residuals "
        f"{ratio:.2f}): the pose reported is the better of the two, and may be the wrong one.",
        "Bring the camera nearer or use a larger board, so that it fills more of the image, and tilt it by "
        f"{ADVISED_TILT}.",
    )
