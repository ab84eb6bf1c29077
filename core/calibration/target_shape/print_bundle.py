"""The bundle of one camera, its poses and the departures of the prints, whose poses are eliminated.

`marginal_poses` has the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.calibration.multi_view import CommonFit
from core.calibration.priors import camera_prior
from core.calibration.residuals import View, residuals_with_jacobian
from core.calibration.target_shape.covariance_factors import inverse
from core.calibration.target_shape.departures import (
    SENSOR_SKEW,
    Departures,
    ShapePrior,
    mirrored,
)
from core.calibration.target_shape.mean_views import (
    MeanView,
    images_by_pose,
    mean_view,
    noise_of,
    smallest_noise,
)
from core.geometry import so3_exp

STEPS = 3
"""At most, from the fit before perfect prints; a bow of a thousandth of the extent is at its end after two."""
SMALLEST_STEP = 0.01
"""In standard uncertainties of all parameters together: a step that is not worth a further linearisation."""
MAX_ELEMENTS = 20_000_000
"""Of the matrix of all poses by all parameters; with more, points have no departure of their own."""


@dataclass(frozen=True)
class BundleState:
    parameters: Float[np.ndarray, " s"]
    rotations: Float[np.ndarray, "m 3 3"]
    translations_mm: Float[np.ndarray, "m 3"]
    shared: Float[np.ndarray, " q"]
    """Skew and departures in units of their priors, behind zeros for the camera."""


@dataclass(frozen=True)
class BundleSystem:
    """Normal equations of z with the poses eliminated, priors included; and what gives the poses back."""

    information: Float[np.ndarray, "q q"]
    gradient: Float[np.ndarray, " q"]
    follows: Float[np.ndarray, "m 6 q"]
    pose_steps: Float[np.ndarray, "m 6"]
    pose_roots: Float[np.ndarray, "m 6 6"]
    """Lower roots of the information of each pose by itself."""
    squares: float
    observations: int
    prior: Float[np.ndarray, "q q"]

    def covariance(self) -> Float[np.ndarray, "q q"]:
        return inverse(self.information)


@dataclass(frozen=True)
class PrintBundle:
    """Camera, poses and departures before the images of a fit."""

    fit: CommonFit
    views: tuple[MeanView, ...]
    departures: tuple[Departures, ...]
    first: tuple[int, ...]
    """Of each target, where its fields and points begin among the parameters."""
    size: int
    free: int
    repeats: bool
    """Whether the noise is that of repeated images."""
    least_growth: float
    """What the smallest noise that points may have leaves of the squares: exact points have some by rounding alone."""

    @classmethod
    def of(cls, fit: CommonFit, priors: Sequence[ShapePrior]) -> PrintBundle:
        stack, free = fit.views, fit.placements.free
        groups = images_by_pose(fit)
        noise, repeats = noise_of(fit, groups)
        views = tuple(mean_view(fit, images, noise) for images in groups)
        found = [Departures.of(t, p) for t, p in zip(stack.targets, priors, strict=True)]
        count = free + 1 + sum(len(d.names) + 2 * d.fields.shape[2] for d in found)
        if 6 * len(views) * count > MAX_ELEMENTS:
            found = [replace(d, point_mm=0.0) for d in found]
        first, size = [], free + 1
        for d in found:
            first.append(size)
            size += len(d.names) + (2 * d.fields.shape[2] if d.point_mm > 0.0 else 0)
        least_growth = (smallest_noise(fit) / noise) ** 2
        return cls(fit, views, tuple(found), tuple(first), size, free, repeats, least_growth)

    def start(self) -> BundleState:
        rows = [int(view.images[0]) for view in self.views]
        placements = self.fit.placements
        return BundleState(
            placements.parameters[rows[0]].copy(),
            placements.rotations[rows].copy(),
            placements.translations_mm[rows].copy(),
            np.zeros(self.size),
        )

    def with_noise_of(self, factor: float) -> PrintBundle:
        """Return the problem with the noise multiplied by a factor."""
        return replace(self, views=tuple(replace(view, root=view.root / factor) for view in self.views))

    def solved(self, state: BundleState) -> tuple[BundleState, BundleSystem]:
        system = self.linearised(state)
        for _ in range(STEPS):
            step = inverse(system.information) @ system.gradient
            if float(step @ system.gradient) < SMALLEST_STEP**2:
                break
            state = self.moved(state, system, step)
            system = self.linearised(state)
        return state, system

    def linearised(self, state: BundleState) -> BundleSystem:
        q, free = self.size, self.free
        N, b = np.zeros((q, q)), np.zeros(q)
        of_poses = np.empty((len(self.views), 6, 6))
        both_sides = np.empty((len(self.views), 6, q + 1))  # of what is shared, and of the residuals
        squares, observations = 0.0, 0
        for g, view in enumerate(self.views):
            departures, begin = self.departures[view.target], self.first[view.target]
            low = len(departures.names)
            fields = departures.fields[:, :, view.cells]
            points = view.points_target + np.tensordot(state.shared[begin : begin + low], fields, axes=1)
            columns = None
            if departures.point_mm > 0.0:
                columns = begin + low + 2 * view.cells[:, None] + np.arange(2)
                points[:2] += departures.point_mm * state.shared[columns].T
            R = state.rotations[g]
            left, J = residuals_with_jacobian(
                np.ascontiguousarray(points - view.centroid[:, None]),
                view.points_px,
                View(state.parameters, R, state.translations_mm[g]),
                free,
            )
            below = (view.points_px[1] - left[1]) - state.parameters[3]
            left = left.copy()
            left[0] -= SENSOR_SKEW * state.shared[free] * below
            by_place = np.einsum("kcn,kj->jcn", J[-3:], R)  # by the point in the target frame
            A = np.empty((free + 1 + low, 2, len(view.root)))
            A[:free] = J[:free]
            A[free, 0], A[free, 1] = SENSOR_SKEW * below, 0.0
            A[free + 1 :] = np.einsum("jcn,kjn->kcn", by_place, fields)
            A, pose, r = (values * view.root for values in (A, J[-6:], left))
            squares += float(np.sum(r * r))
            observations += 2 * int(np.count_nonzero(view.root))
            dense = np.concatenate([np.arange(free + 1), np.arange(begin, begin + low)])
            flat, of_pose = A.reshape(len(A), -1), pose.reshape(6, -1)
            N[np.ix_(dense, dense)] += flat @ flat.T
            b[dense] += flat @ r.ravel()
            across = np.zeros((6, q))
            across[:, dense] = of_pose @ flat.T
            if columns is not None:
                P = departures.point_mm * by_place[:2] * view.root
                N[columns[:, :, None], columns[:, None, :]] += np.einsum("icn,jcn->nij", P, P)
                both = np.einsum("acn,icn->nia", A, P)
                N[columns[:, :, None], dense] += both
                b[columns] += np.einsum("icn,cn->ni", P, r)
                across[:, columns] = np.einsum("acn,icn->ani", pose, P)
            of_poses[g] = of_pose @ of_pose.T
            both_sides[g, :, :q], both_sides[g, :, q] = across, of_pose @ r.ravel()
        lower = np.linalg.cholesky(of_poses)
        halves = np.linalg.solve(lower, both_sides)
        whole = np.linalg.solve(np.swapaxes(lower, 1, 2), halves)
        roots = halves[:, :, :q]
        b -= np.einsum("gaq,ga->q", roots, halves[:, :, q])
        N = mirrored(N, self.free + 1, self.first, self.departures)
        tall = roots.reshape(-1, q)
        N -= tall.T @ tall
        prior, pull = self._prior(state)
        return BundleSystem(
            N + prior, b + pull, whole[:, :, :q], whole[:, :, q], lower, squares, observations, prior
        )

    def _prior(self, state: BundleState) -> tuple[Float[np.ndarray, "q q"], Float[np.ndarray, " q"]]:
        prior = np.eye(self.size)
        pull = -state.shared.copy()
        of_camera = camera_prior(
            self.fit.views.image_width_px,
            self.fit.views.image_height_px,
            self.fit.lens,
            model_size=len(state.parameters),
        )
        residual, Q = of_camera(state.parameters)
        prior[: self.free, : self.free] = Q.T @ Q
        pull[: self.free] = Q.T @ residual
        return prior, pull

    def moved(self, state: BundleState, system: BundleSystem, z: Float[np.ndarray, " q"]) -> BundleState:
        """Return the state after a step `z` of what is shared, the poses where they are best with it."""
        poses = system.pose_steps - system.follows @ z
        parameters = state.parameters.copy()
        parameters[: self.free] += z[: self.free]
        shared = state.shared + np.concatenate([np.zeros(self.free), z[self.free :]])
        rotations = np.array([so3_exp(w) @ R for w, R in zip(poses[:, :3], state.rotations, strict=True)])
        return BundleState(parameters, rotations, state.translations_mm + poses[:, 3:], shared)

    def growth(self, system: BundleSystem) -> float:
        """Return by how much the residuals of mean views exceed their noise.

        With repeats, whose scatter is the noise: at least 1, with chance shrunk away. Without any: the ratio as it is,
        which is then the noise's own estimate.
        """
        fitted = self.size - float(np.sum(system.covariance() * system.prior))
        freedom = max(system.observations - 6 * len(self.views) - fitted, 1.0)
        ratio = system.squares / freedom
        if not self.repeats:
            return max(ratio, self.least_growth)
        excess = max(ratio - 1.0, 0.0)
        z_squared = excess**2 * freedom / 2.0
        return 1.0 + excess * z_squared / (1.0 + z_squared)
