"""One camera of any lens model fitted to some views on given points, with or without the board's shape.

What is compared between lens models has to come from the same points, with the same weights and without rejection: a
robust fit under the poorer model would reject the image's edge, where the models differ. So this is a plain fit of
points that are given. The board's shape is sixteen low-order departures in common to all views of a target, with weak
priors: a bent print imitates a lens, and only what it cannot imitate is the lens's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.multi_view import Placements, ViewStack, coordinates, moved
from core.calibration.priors import Lens, camera_prior
from core.calibration.residuals import View, descend, residuals_with_jacobian
from core.geometry import AnyCamera, camera_from_array, free_parameters, project_any_with_jacobian

ITERATIONS = 25
FOLDS = 5
"""Into which views are dealt, in their order."""
MIN_GAIN = 1e-6
"""Of the cost: steps that gain less end the fit."""
MAX_DAMPING = 1e6
SHAPE_PRIOR = 3e-3
"""Standard deviation of a departure of the board, of half its extent: far more than prints have."""
RADIAL_POWERS = (3, 4, 5)
"""Of r²: the radial terms beyond Brown's k1 and k2 that the first look adds to it."""


@dataclass(frozen=True, slots=True)
class CommonCamera:
    """A camera fitted to views: their placements, and the sum of squared residuals in stated uncertainties."""

    placements: Placements
    chi2: float

    @property
    def camera(self) -> AnyCamera:
        return camera_from_array(self.placements.parameters[0])


@dataclass(frozen=True, slots=True)
class _Equations:
    """Normal equations with the poses eliminated: `head` and `right` of what is common, to recover each pose `alone`
    and `by_common`; `cost` in stated uncertainties.
    """

    head: Float[np.ndarray, "s s"]
    right: Float[np.ndarray, " s"]
    alone: Float[np.ndarray, "m 6"]
    by_common: Float[np.ndarray, "m 6 s"]
    cost: float


def fit_common_camera(
    views: ViewStack,
    start: Placements,
    used: Bool[np.ndarray, " n"],
    scale: float,
    lens: Lens | None,
    *,
    shape: bool = False,
) -> CommonCamera:
    """Fit the camera of the start's model, and each view's pose, to the points `used`; `scale` is their noise per unit
    of stated uncertainty, which data and priors are weighed by.
    """
    basis = _departures(views) if shape else np.zeros((0, 3, len(views.column)))
    count = len(basis)
    prior = camera_prior(
        views.image_width_px, views.image_height_px, lens, model_size=start.parameters.shape[1]
    )
    free = free_parameters(start.parameters.shape[1])

    def of_priors(at: Placements, d: Float[np.ndarray, " b"]) -> tuple[np.ndarray, np.ndarray, float]:
        q, Q = prior(at.parameters[0])
        Q = Q[:, :free] @ coordinates(at.parameters[0])
        H, g = np.zeros((free + count, free + count)), np.zeros(free + count)
        H[:free, :free], g[:free] = Q.T @ Q, Q.T @ q
        H[free:, free:], g[free:] = np.eye(count), -d
        return H * scale**2, g * scale**2, float(q @ q + d @ d) * scale**2

    at, d, damping = start, np.zeros(count), 0.0
    equations = _linearised(views, at, used, basis, d, 0)
    H, g, penalty = of_priors(at, d)
    total = equations.cost + penalty
    for _ in range(ITERATIONS):
        A = equations.head + H
        step = np.linalg.solve(A + damping * np.diag(np.diag(A)), equations.right + g)
        pose = equations.alone - equations.by_common @ step
        lens_step = np.tile(step[:free], (len(at), 1))
        candidate, departed = moved(at, lens_step, pose), d + step[free:]
        found = _linearised(views, candidate, used, basis, departed, 0)
        of_candidate = of_priors(candidate, departed)
        if found.cost + of_candidate[2] < total:
            gained, total = total - found.cost - of_candidate[2], found.cost + of_candidate[2]
            at, d, equations, (H, g, penalty) = candidate, departed, found, of_candidate
            damping = 0.0 if damping < 1e-4 else 0.1 * damping
            if gained < MIN_GAIN * total:
                break
        else:
            damping = max(10.0 * damping, 1e-3)
            if damping > MAX_DAMPING:
                break
    return CommonCamera(at, equations.cost)


def radial_gain(
    views: ViewStack, at: Placements, used: Bool[np.ndarray, " n"], scale: float, lens: Lens | None
) -> tuple[float, float]:
    """Return the sum of squared residuals at placements of Brown's model, and how much of it radial terms beyond the
    model would take away, to first order, with camera and poses following.
    """
    extra = len(RADIAL_POWERS)
    equations = _linearised(views, at, used, np.zeros((0, 3, len(views.column))), np.zeros(0), extra)
    q, Q = camera_prior(views.image_width_px, views.image_height_px, lens)(at.parameters[0])
    Q = Q @ coordinates(at.parameters[0])
    A, b = equations.head.copy(), equations.right.copy()
    A[:8, :8] += scale**2 * Q.T @ Q
    b[:8] += scale**2 * Q.T @ q
    unit = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    A, b = A * np.outer(unit, unit), b * unit
    whole = b @ np.linalg.lstsq(A, b, rcond=1e-12)[0]
    without = b[:8] @ np.linalg.lstsq(A[:8, :8], b[:8], rcond=1e-12)[0]
    return equations.cost, max(float(whole - without), 0.0)


def _linearised(
    views: ViewStack,
    at: Placements,
    used: Bool[np.ndarray, " n"],
    basis: Float[np.ndarray, "b 3 n"],
    departures: Float[np.ndarray, " b"],
    radial: int,
) -> _Equations:
    camera = camera_from_array(at.parameters[0])
    of_camera = coordinates(at.parameters[0])
    free, b = len(of_camera), len(basis)
    s = free + b + radial
    head, right, cost = np.zeros((s, s)), np.zeros(s), 0.0
    alone, by_common = np.zeros((len(at), 6)), np.zeros((len(at), 6, s))
    for i in range(len(at)):
        part = views.part(i)
        target = (views.points_target[part] - views.centroids[i]).T
        if b:
            target = target + np.tensordot(departures, basis[:, :, part], axes=1)
        R = at.rotations[i]
        X, Y, Z = turned = R @ target
        pixels, by_camera, by_point = project_any_with_jacobian(
            (turned + at.translations_mm[i][:, None]).T, camera
        )
        rows = np.empty((s + 7, 2, target.shape[1]))
        rows[:free] = np.tensordot(of_camera.T, by_camera[:free], axes=1)
        if b:
            by_target = np.tensordot(R.T, by_point, axes=1)
            rows[free : free + b] = np.einsum("bjn,jcn->bcn", basis[:, :, part], by_target)
        if radial:
            depth = Z + at.translations_mm[i][2]
            x = (X + at.translations_mm[i][0]) / depth
            y = (Y + at.translations_mm[i][1]) / depth
            r2 = x * x + y * y
            for k, power in enumerate(RADIAL_POWERS):
                rows[free + b + k, 0] = camera.fx_px * x * r2**power
                rows[free + b + k, 1] = camera.fy_px * y * r2**power
        rows[s] = by_point[2] * Y - by_point[1] * Z
        rows[s + 1] = by_point[0] * Z - by_point[2] * X
        rows[s + 2] = by_point[1] * X - by_point[0] * Y
        rows[s + 3 : s + 6] = by_point
        rows[s + 6] = views.points_px[part].T - pixels
        rows *= np.where(used[part], np.sqrt(views.weight[part]), 0.0)
        flat = rows.reshape(s + 7, -1)
        N = flat @ flat.T
        cost += float(N[-1, -1])
        P, C, g = N[s:-1, s:-1], N[s:-1, :s], N[s:-1, -1]
        solved = np.linalg.solve(P, np.column_stack([C, g]))
        by_common[i], alone[i] = solved[:, :s], solved[:, s]
        head += N[:s, :s] - C.T @ solved[:, :s]
        right += N[:s, -1] - C.T @ solved[:, s]
    return _Equations(head, right, alone, by_common, cost)


def _departures(views: ViewStack) -> Float[np.ndarray, "b 3 n"]:
    """Return the sixteen departures of each target at every point, mm for one standard deviation of their priors: eight
    of the plane (bow, twist and what is of third and fourth order), and eight within it (aspect, shear, second order).
    """
    found = []
    of_points = views.spread(views.target)
    for target in np.unique(views.target).tolist():
        members = of_points == target
        at = views.points_target[members, :2]
        middle, half = 0.5 * (at.max(axis=0) + at.min(axis=0)), 0.5 * float(np.ptp(at, axis=0).max())
        a, b = ((at - middle) / half).T
        quadratic = [a * a, a * b, b * b]
        out = [*quadratic, a**3, a * a * b, a * b * b, b**3, a * a * b * b]
        within = [(a, -b), (b, a), *((f, 0 * f) for f in quadratic), *((0 * f, f) for f in quadratic)]
        of_target = np.zeros((16, 3, len(of_points)))
        for k, f in enumerate(out):
            of_target[k, 2, members] = f
        for k, (f, g) in enumerate(within):
            of_target[8 + k, 0, members], of_target[8 + k, 1, members] = f, g
        found.append(of_target * (SHAPE_PRIOR * half))
    return np.concatenate(found)


def squared_distances(views: ViewStack, at: Placements) -> Float[np.ndarray, " n"]:
    """Return every point's squared distance in stated uncertainties."""
    found = np.empty(len(views.column))
    for i in range(len(views)):
        part = views.part(i)
        left, _ = residuals_with_jacobian(*views.centred(i, part), at.view(i), 0)
        found[part] = np.sum(left**2, axis=0) * views.weight[part]
    return found


def held_out_rms(
    views: ViewStack, at: Placements, used: Bool[np.ndarray, " n"], scale: float, lens: Lens | None
) -> Float[np.ndarray, " m"]:
    """Return each view's residual rms, in stated uncertainties, before the camera of the other folds' views; the pose
    alone is its own.
    """
    found = np.empty(len(views))
    count = min(FOLDS, len(views))
    for fold in range(count):
        out = np.arange(fold, len(views), count)
        rest = np.setdiff1d(np.arange(len(views)), out)
        others = views.spread(np.isin(np.arange(len(views)), rest))
        fitted = fit_common_camera(views.take(rest), at.take(rest), used[others], scale, lens)
        parameters = fitted.placements.parameters[0]
        for i in out.tolist():
            part = views.part(i)
            _, cost = descend(
                *views.centred(i, part),
                used[part] * np.sqrt(views.weight[part]),
                View(parameters, at.rotations[i], at.translations_mm[i]),
                30,
                known_cost=0.0,
                share=0.0,
                least=1e-6,
            )
            found[i] = math.sqrt(max(cost, 1e-300) / max(int(used[part].sum()), 1))
    return found
