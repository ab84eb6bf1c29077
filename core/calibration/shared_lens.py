"""Many views, one lens: a pose for every view, with what the views share and what each has of its own told apart.

Camera coordinates of a step: log f (fx and fy together), log(fx/fy), then cx, cy, k1, k2, p1, p2; a pose has six. A
`Sharing` says which of them all views have in common and which each has by itself. With shared coordinates s and a
view's own l, the normal equations are an arrow,

    [A  C₁ C₂ ...] [s ]   [a ]
    [C₁ᵀ L₁      ] [l₁] = [b₁]
    [C₂ᵀ    L₂   ] [l₂]   [b₂]

whose head is solved first: (A - Σ Cᵢ Lᵢ⁻¹ Cᵢᵀ) s = a - Σ Cᵢ Lᵢ⁻¹ bᵢ, and then lᵢ = Lᵢ⁻¹ (bᵢ - Cᵢᵀ s). The cost is
linear in the number of views.

Robust in stages, as the solver of one image is: plain least squares, which is the answer where its residuals are the
noise that was stated and nothing stands out; else Cauchy weights by each view's own scale, then rejection of points
beyond 4 MAD (`inliers`) and of whole views whose residuals are far above the others', then plain least squares again.

References: B. Triggs, P. McLauchlan, R. Hartley, A. Fitzgibbon, "Bundle adjustment: a modern synthesis", 1999,
section 6.1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.inliers import Repeats, find_repeats, inliers_of
from core.calibration.model import SMALLEST_NOISE_PX, Lens, camera_prior, centred
from core.calibration.view_residuals import residuals_with_jacobian
from core.least_squares import (
    CAUCHY_C,
    EXPECTED_SCALE,
    MEDIAN_LENGTH,
    NEGLIGIBLE_STEP,
    OBSERVATIONS_PER_PARAMETER,
    PLAIN_ITERATIONS,
    ROBUST_STEP_TOLERANCE,
    STEP_TOLERANCE,
)
from core.targets.specification import GridPoints
from core.transforms import so3_exp

ITERATIONS = 40
FOREIGN = 5.0
"""A view whose residuals are this many times the median view's is not one of the others' kind."""
DAMPING_AT_MOST = 1e6

CameraPrior = Callable[[Float[np.ndarray, "9"]], tuple[Float[np.ndarray, " q"], Float[np.ndarray, "q p"]]]


@dataclass(frozen=True, slots=True)
class Sharing:
    """Which camera coordinates views have in common, and which each has of its own beside its pose."""

    common: tuple[int, ...]
    own: tuple[int, ...]


TIED = Sharing(common=tuple(range(8)), own=())
FREE_FOCAL = Sharing(common=tuple(range(1, 8)), own=(0,))
KNOWN = Sharing(common=(), own=())


@dataclass(frozen=True, slots=True)
class Placement:
    """One view's state: camera parameters in the order of `CAMERA_PARAMETERS`, rotation, and the position of its grid
    points' centroid in the camera frame (mm).
    """

    parameters: Float[np.ndarray, "9"]
    rotation: Float[np.ndarray, "3 3"]
    translation_mm: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class SharedLens:
    """What views with something in common amount to.

    `covariance` (9, 9) of the common camera parameters, in the order of `CAMERA_PARAMETERS`; what views have of their
    own is 0 there. `scale` is σ per unit of the points' stated uncertainty. `kept` is false for views left out.
    `converged` is false where the iteration did not come to its end: then this is no answer, but shows what could not
    be told.
    """

    at: Linearised
    covariance: Float[np.ndarray, "9 9"]
    used: tuple[Bool[np.ndarray, " _"], ...]
    kept: Bool[np.ndarray, " m"]
    scale: float
    converged: bool


def fit_shared_lens(
    views: Sequence[GridPoints],
    start: Sequence[Placement],
    sharing: Sharing,
    *,
    lens: Lens | None = None,
    repeats: Sequence[Hashable] | None = None,
) -> SharedLens:
    """Fit all views at once from `start`, one placement per view; views of one label in `repeats` show one pose."""
    problem = _Problem(
        tuple(_prepared(v) for v in views),
        find_repeats(views, repeats),
        sharing,
        camera_prior(views[0].image_width_px, views[0].image_height_px, lens),
    )
    everything = tuple(np.ones(len(v), dtype=np.bool_) for v in views)
    at, scale, converged = problem.plain(
        tuple(start), everything, np.ones(len(views), dtype=np.bool_), EXPECTED_SCALE, PLAIN_ITERATIONS
    )
    kept, used = problem.inliers(at)
    clean = converged and all(bool(u.all()) for u in used)
    if clean and scale <= EXPECTED_SCALE and problem.redundant():
        return problem.summary(at, used, kept, scale, converged)
    # Gross errors can pull a plain fit anywhere: then it is no start for the next stage either.
    at = problem.robust(at.placements if clean else tuple(start))
    kept, used = problem.inliers(at)
    at, scale, converged = problem.plain(at.placements, used, kept)
    return problem.summary(at, used, kept, scale, converged)


def linearise(
    views: Sequence[GridPoints], placements: Sequence[Placement], used: Sequence[Bool[np.ndarray, " _"]]
) -> Linearised:
    """Return normal matrices, gradients and residuals of views at their placements, over the points used."""
    return _linearised(tuple(_prepared(v) for v in views), tuple(placements), tuple(used))


@dataclass(frozen=True, slots=True)
class _View:
    target: Float[np.ndarray, "3 n"]
    observed: Float[np.ndarray, "2 n"]
    weight: Float[np.ndarray, " n"]  # 1/u²


def _prepared(points: GridPoints) -> _View:
    return _View(
        np.ascontiguousarray(centred(points)[0].T),
        np.ascontiguousarray(points.points_px.T),
        1.0 / points.standard_uncertainty_px**2,
    )


@dataclass(frozen=True, slots=True)
class Linearised:
    """Views at their placements: `normal` and `gradient` at unit scale over the camera's first eight parameters, a
    rotation about the centroid and a translation; `residuals` in px, `distance` in stated uncertainties.
    """

    placements: tuple[Placement, ...]
    normal: Float[np.ndarray, "m 14 14"]
    gradient: Float[np.ndarray, "m 14"]
    residuals: tuple[Float[np.ndarray, "2 _"], ...]
    distance: tuple[Float[np.ndarray, " _"], ...]
    cost: float


@dataclass(frozen=True, slots=True)
class _Arrow:
    """Normal equations in step coordinates: the common ones, and each view's own apart."""

    A: Float[np.ndarray, "s s"]
    a: Float[np.ndarray, " s"]
    C: Float[np.ndarray, "m s l"]
    L: Float[np.ndarray, "m l l"]
    b: Float[np.ndarray, "m l"]

    def solve(self, damping: float) -> tuple[Float[np.ndarray, " s"], Float[np.ndarray, "m l"], float]:
        """Return the common step, the views' own, and the longest of them in units of its own uncertainty."""
        L = self.L * (1.0 + damping * np.eye(self.L.shape[-1]))
        by_common = np.linalg.solve(L, np.swapaxes(self.C, 1, 2))
        own = np.linalg.solve(L, self.b[..., None])[..., 0]
        common = self.a
        if len(common):
            head = self.A * (1.0 + damping * np.eye(len(self.a))) - np.einsum(
                "msl,mlk->sk", self.C, by_common
            )
            common = np.linalg.solve(head, self.a - np.einsum("msl,ml->s", self.C, own))
            own = own - by_common @ common
        lengths = np.einsum("ml,mlk,mk->m", own, self.L, own)
        longest = max(float(common @ self.information() @ common), float(lengths.max()), 0.0)
        return common, own, math.sqrt(longest)

    def information(self) -> Float[np.ndarray, "s s"]:
        """The information on the common coordinates with the views' own eliminated."""
        by_common = np.linalg.solve(self.L, np.swapaxes(self.C, 1, 2))
        return np.asarray(self.A - np.einsum("msl,mlk->sk", self.C, by_common))


@dataclass(frozen=True, slots=True)
class _Problem:
    views: tuple[_View, ...]
    repeats: tuple[Repeats, ...]
    sharing: Sharing
    prior: CameraPrior

    def redundant(self) -> bool:
        """Whether every view has points enough that gross errors cannot hide in a plain fit."""
        parameters = 6 + len(self.sharing.own)
        return all(v.observed.size >= OBSERVATIONS_PER_PARAMETER * parameters for v in self.views)

    def inliers(self, at: Linearised) -> tuple[Bool[np.ndarray, " m"], tuple[Bool[np.ndarray, " _"], ...]]:
        """Return which views are of the others' kind, and which of their points count."""
        median = np.array([float(np.median(d)) for d in at.distance])
        floor = SMALLEST_NOISE_PX * np.array([math.sqrt(float(np.median(v.weight))) for v in self.views])
        kept = median <= FOREIGN * np.maximum(np.median(median), floor)
        return kept, inliers_of(self.repeats, at.residuals, kept)

    def robust(self, start: tuple[Placement, ...]) -> Linearised:
        """Iterate with Cauchy weights, σ from each view's own median, while residuals become smaller."""
        at = _linearised(self.views, start, None)
        damping = 0.0
        for _ in range(ITERATIONS):
            common, own, length = self.arrow(at, 1.0).solve(damping)
            candidate = _linearised(self.views, self.moved(at.placements, common, own), None)
            if candidate.cost <= at.cost:
                at, damping = candidate, 0.1 * damping if damping > 1e-4 else 0.0
            else:
                damping = max(10.0 * damping, 1e-3)
            if length < ROBUST_STEP_TOLERANCE or damping > DAMPING_AT_MOST:
                break
        return at

    def plain(
        self,
        start: tuple[Placement, ...],
        used: tuple[Bool[np.ndarray, " _"], ...],
        kept: Bool[np.ndarray, " m"],
        largest: float = math.inf,
        limit: int = ITERATIONS,
    ) -> tuple[Linearised, float, bool]:
        """Iterate with the points `used`; return σ per unit of stated uncertainty and whether the end was reached.

        `largest` bounds the σ that steps are weighed with.
        """
        at = _linearised(self.views, start, used)
        points = sum(int(u.sum()) for u in used)
        freedom = max(
            2 * points - int(kept.sum()) * (6 + len(self.sharing.own)) - len(self.sharing.common), 1
        )
        smallest = SMALLEST_NOISE_PX * float(
            np.median([math.sqrt(float(np.median(v.weight))) for v in self.views])
        )
        damping = 0.0
        for _ in range(limit):
            found = max(math.sqrt(at.cost / freedom), smallest)
            scale = min(found, largest)
            common, own, length = self.arrow(at, scale).solve(damping)
            if length < NEGLIGIBLE_STEP and not damping:
                return at, found, True
            candidate = _linearised(self.views, self.moved(at.placements, common, own), used)
            if self.total(candidate, scale) <= self.total(at, scale):
                at, damping = candidate, 0.1 * damping if damping > 1e-4 else 0.0
                if length < STEP_TOLERANCE and not damping:
                    return at, max(math.sqrt(at.cost / freedom), smallest), True
            elif length < STEP_TOLERANCE:  # the end, but for rounding errors
                return at, found, True
            else:
                damping = max(10.0 * damping, 1e-3)
                if damping > DAMPING_AT_MOST:
                    break
        return at, max(math.sqrt(at.cost / freedom), smallest), False

    def total(self, at: Linearised, scale: float) -> float:
        q, _ = self.prior(at.placements[0].parameters)
        return at.cost / scale**2 + (float(q @ q) if self.sharing.common else 0.0)

    def arrow(self, at: Linearised, scale: float) -> _Arrow:
        """Take the camera parameters to step coordinates, and add the priors to the head."""
        common, own = list(self.sharing.common), list(self.sharing.own)
        change = np.zeros((len(self.views), 14, 14))
        change[:, 8:, 8:] = np.eye(6)
        for i, placement in enumerate(at.placements):
            change[i, :8, :8] = coordinates(placement.parameters)
        transposed = np.swapaxes(change, 1, 2)
        N = transposed @ at.normal @ change / scale**2
        g = (transposed @ at.gradient[..., None])[..., 0] / scale**2
        local = [*own, *range(8, 14)]
        L = N[:, local][:, :, local]
        # A view that is left out stays where it is.
        empty = ~np.any(L, axis=(1, 2))
        L[empty] = np.eye(len(local))
        A, a = N[:, common][:, :, common].sum(axis=0), g[:, common].sum(axis=0)
        if common:
            parameters = at.placements[0].parameters
            q, Q = self.prior(parameters)
            Q = (Q @ coordinates(parameters))[:, common]
            A, a = A + Q.T @ Q, a + Q.T @ q
        return _Arrow(A, a, N[:, common][:, :, local], L, g[:, local])

    def moved(
        self,
        placements: tuple[Placement, ...],
        common: Float[np.ndarray, " s"],
        own: Float[np.ndarray, "m l"],
    ) -> tuple[Placement, ...]:
        moved = []
        step = np.zeros(8)
        step[list(self.sharing.common)] = common
        for placement, of_view in zip(placements, own, strict=True):
            step[list(self.sharing.own)] = of_view[:-6]
            moved.append(_moved(placement, step, of_view[-6:]))
        return tuple(moved)

    def summary(
        self,
        at: Linearised,
        used: tuple[Bool[np.ndarray, " _"], ...],
        kept: Bool[np.ndarray, " m"],
        scale: float,
        converged: bool,
    ) -> SharedLens:
        covariance = np.zeros((9, 9))
        if self.sharing.common:
            by_step = coordinates(at.placements[0].parameters)[:, list(self.sharing.common)]
            covariance[:8, :8] = by_step @ np.linalg.inv(self.arrow(at, scale).information()) @ by_step.T
        return SharedLens(at, covariance, used, kept, scale, converged)


def _linearised(
    views: tuple[_View, ...],
    placements: tuple[Placement, ...],
    used: tuple[Bool[np.ndarray, " _"], ...] | None,
) -> Linearised:
    """Evaluate every view; without `used`, robustly: each view by its own scale, which the cost is made of."""
    count = len(views)
    normal, gradient = np.empty((count, 14, 14)), np.empty((count, 14))
    residuals, distance = [], []
    cost = 0.0
    for i, (view, at) in enumerate(zip(views, placements, strict=True)):
        r, J = residuals_with_jacobian(
            view.target, view.observed, at.parameters, at.rotation, at.translation_mm, 8
        )
        squared = np.einsum("mn,mn->n", r, r) * view.weight
        d = np.sqrt(squared)
        if used is None:
            scale = max(math.sqrt(float(np.median(squared))) / MEDIAN_LENGTH[2], 1e-9)
            weight = view.weight / (scale**2 * (1.0 + squared / (CAUCHY_C * scale) ** 2))
            cost += 2.0 * len(d) * math.log(scale)
        else:
            weight = view.weight * used[i]
            cost += float(squared @ used[i])
        root = np.sqrt(weight)
        J *= root
        weighted = J.reshape(14, -1)
        np.matmul(weighted, weighted.T, out=normal[i])
        np.matmul(weighted, (r * root).ravel(), out=gradient[i])
        residuals.append(r)
        distance.append(d)
    return Linearised(placements, normal, gradient, tuple(residuals), tuple(distance), cost)


def coordinates(parameters: Float[np.ndarray, "9"]) -> Float[np.ndarray, "8 8"]:
    """Return the derivatives of the first eight camera parameters by the step's coordinates."""
    fx, fy = float(parameters[0]), float(parameters[1])
    change = np.eye(8)
    change[:2, :2] = [[fx, 0.5 * fx], [fy, -0.5 * fy]]
    return change


def _moved(placement: Placement, step: Float[np.ndarray, "8"], pose: Float[np.ndarray, "6"]) -> Placement:
    parameters = placement.parameters.copy()
    focal, ratio = min(max(float(step[0]), -0.5), 0.5), min(max(float(step[1]), -0.1), 0.1)
    parameters[0] *= math.exp(focal + 0.5 * ratio)
    parameters[1] *= math.exp(focal - 0.5 * ratio)
    parameters[2:8] += step[2:]
    translation = placement.translation_mm + pose[3:]
    # A centroid never passes through the camera.
    translation[2] = placement.translation_mm[2] * math.exp(
        min(max(float(pose[5]) / float(placement.translation_mm[2]), -0.7), 0.7)
    )
    return Placement(parameters, so3_exp(pose[:3]) @ placement.rotation, translation)
