"""Covariances of poses from the normal matrices of many views: scatter, and errors common to all views.

A view's own coordinates l (its pose and what else it has by itself) have the data's information N and the priors' P, so
that the estimate's covariance about the truth is C = (N + P)⁻¹. Repeated, the same view's estimates scatter about their
own mean by C N C only: where a prior pulls all of them the same way, it makes no scatter. Without priors both are N⁻¹.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import chdtri

from core.calibration.multi_view.repeat_consistency import is_same_scene, sums_of_squared_deviations
from core.calibration.multi_view.view_stack import Placements, ViewStack, groups_of
from core.calibration.state import SMALLEST_NOISE_PX
from core.geometry import free_parameters, rotation_vectors

MIN_DEGREES_OF_FREEDOM = 200
"""Degrees of freedom below which images of one pose do not determine their noise by themselves."""
MIN_REPEATS = 3
MAX_DISAGREEMENT = 1.5
SIGNIFICANCE = 1e-4
MIN_VISIBLE_SHARE = 0.25
"""Of the poses' scatter: what a changing camera makes of it counts from here on."""
MIN_EIGENVALUE = 1e-10
"""Of the camera's normal matrix scaled to unit diagonal: below it a view says nothing of that combination."""


@dataclass(frozen=True, slots=True)
class SchurBlocks:
    """Every view's normal equations, with its own coordinates l separated from the camera's free parameters.

    `L` is l's information, `by_camera` = L⁻¹ Cᵀ how the best l follows the camera; `S` and `g` are the camera's
    information and gradient once l is eliminated. All at unit scale.
    """

    L: Float[np.ndarray, "k l l"]
    by_camera: Float[np.ndarray, "k l c"]
    S: Float[np.ndarray, "k c c"]
    g: Float[np.ndarray, "k c"]
    unit: Float[np.ndarray, "k c"]
    """1/√ of the camera's own diagonal: of each parameter its scale, whatever the view says of it."""


def reduced(products: Float[np.ndarray, "k q q"], own: Float[np.ndarray, "k p l"] | None) -> SchurBlocks:
    """Eliminate what each view has of its own: `own` are its derivatives of camera and pose; None is the pose alone."""
    c = products.shape[1] - 7  # the camera's; then the pose's six and the residuals
    if own is None:
        L, C, b = products[:, c:-1, c:-1], products[:, c:-1, :c], products[:, c:-1, -1:]
    else:
        rows = np.swapaxes(own, 1, 2) @ products[:, :-1]
        L, C, b = rows[:, :, :-1] @ own, rows[:, :, :c], rows[:, :, -1:]
    solved = np.linalg.solve(L, np.concatenate([C, b], axis=2))
    back = np.swapaxes(C, 1, 2) @ solved
    diagonal = np.diagonal(products, axis1=1, axis2=2)[:, :c]
    return SchurBlocks(
        L,
        solved[:, :, :c],
        products[:, :c, :c] - back[:, :, :c],
        products[:, :c, -1] - back[:, :, c],
        1.0 / np.sqrt(np.maximum(diagonal, 1e-300)),
    )


def pose_covariances(
    N: Float[np.ndarray, "k l l"], P: Float[np.ndarray, "k l l"] | None
) -> tuple[Float[np.ndarray, "k l l"], Float[np.ndarray, "k l l"]]:
    """Return (C, C N C); without priors they are the same."""
    C = np.linalg.inv(N if P is None else N + P)
    C = 0.5 * (C + np.swapaxes(C, 1, 2))
    return (C, C) if P is None else (C, C @ N @ C)


def in_target_frame(
    rotations: Float[np.ndarray, "k 3 3"],
    centroids_camera_mm: Float[np.ndarray, "k 3"],
) -> Float[np.ndarray, "k 6 6"]:
    """Return J that takes a perturbation of T_camera_target about the grid's centroid, (w, d) in the camera frame, to
    one of the camera's pose in the target frame, (p', w'):

        w' = -Rᵀ w,      p' = -Rᵀ [t]× w - Rᵀ d.
    """
    R_target_camera = np.swapaxes(rotations, 1, 2)
    x, y, z = centroids_camera_mm.T
    cross = np.zeros_like(rotations)
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    J = np.zeros((len(rotations), 6, 6))
    J[:, :3, :3] = -R_target_camera @ cross
    J[:, :3, 3:] = J[:, 3:, :3] = -R_target_camera
    return J


def transformed(J: Float[np.ndarray, "k a b"], C: Float[np.ndarray, "#k b b"]) -> Float[np.ndarray, "k a a"]:
    """Return J C Jᵀ, symmetric to the last bit."""
    result = J @ C @ np.swapaxes(J, 1, 2)
    return np.asarray(0.5 * (result + np.swapaxes(result, 1, 2)))


def repeated_scales(
    views: ViewStack,
    residuals: Float[np.ndarray, "2 n"],
    used: Bool[np.ndarray, " n"],
    labels: Int[np.ndarray, " k"],
    parameters: int,
    otherwise: float,
) -> Float[np.ndarray, " k"]:
    """Return σ per unit of stated uncertainty for every view, from residuals about the mean of the views of its label.

    `parameters` each view has of its own; `otherwise` is for where there are no repeated views. Never below what
    `SMALLEST_NOISE_PX` is of the uncertainty: one image stored many times has no noise, which no instrument has.
    """
    groups = groups_of(labels * len(views.targets) + views.target)
    squares = [_about_mean(views, residuals, used, group, parameters) for group in groups]
    total, freedom = (sum(part) for part in zip(*squares, strict=True))
    common = float(np.sqrt(total / freedom)) if freedom >= MIN_DEGREES_OF_FREEDOM else otherwise
    scales = np.empty(len(views))
    for group, (square, of_label) in zip(groups, squares, strict=True):
        scale = float(np.sqrt(square / of_label)) if of_label >= MIN_DEGREES_OF_FREEDOM else common
        scales[group] = max(scale, SMALLEST_NOISE_PX / float(views.uncertainty[group[0]]))
    return scales


def _about_mean(
    views: ViewStack,
    residuals: Float[np.ndarray, "2 n"],
    used: Bool[np.ndarray, " n"],
    group: Int[np.ndarray, " g"],
    parameters: int,
) -> tuple[float, int]:
    """Return the sum of squares about the mean, in stated uncertainties, and its degrees of freedom."""
    if len(group) < 2:
        return 0.0, 0
    if not is_same_scene(views, group):
        shown = np.concatenate([np.arange(views.first[i], views.first[i + 1]) for i in group])
        shown = shown[used[shown]]
        total, freedom = sums_of_squared_deviations(
            views.cell[shown], residuals[:, shown], views.standard_uncertainty_px[shown]
        )
        freedom -= (len(group) - 1) * parameters
        return (total, freedom) if freedom > 0 else (0.0, 0)
    points = views.first[group][:, None] + np.arange(views.counts[group[0]])
    everywhere = used[points].all(axis=0)
    freedom = (len(group) - 1) * (2 * int(everywhere.sum()) - parameters)
    if freedom <= 0:
        return 0.0, 0
    points = points[:, everywhere]
    uncertainty = views.standard_uncertainty_px[points].mean(axis=0)
    total = 0.0
    for component in residuals:
        about = component[points]
        about -= about.mean(axis=0)
        about *= about
        total += float(np.sum(about.sum(axis=0) / uncertainty**2))
    return total, freedom


def disagreement(
    views: SchurBlocks,
    squares: Float[np.ndarray, " k"],
    observations: Float[np.ndarray, " k"],
    common: int,
) -> float | None:
    """Return how far views contradict a common camera, 1 being what chance makes; None where it cannot be tested.

    One step from the common answer toward a camera of its own lessens a view's squared residuals by gᵀ S⁺ g (Rao's
    score test); over the noise variance that the view's residuals leave, that is χ² with rank(S) degrees of freedom if
    the camera is right. The sum over views is compared with its expectation, `common` parameters having been fitted.
    """
    gain, rank = score_test(views.S, views.g, views.unit)
    left = observations - views.L.shape[1] - rank
    enough = left > 0
    if not enough.any() or int(rank[enough].sum()) <= common:
        return None
    variance = np.maximum(squares - gain, 1e-12 * squares + 1e-300) / np.maximum(left, 1.0)
    return float(np.sum((gain / variance)[enough]) / (int(rank[enough].sum()) - common))


def drifting_cameras(
    views: ViewStack,
    labels: Int[np.ndarray, " k"],
    parts: SchurBlocks,
    placements: Placements,
    variance: Float[np.ndarray, "k 3"],
) -> Bool[np.ndarray, " k"]:
    """Return for every view whether the camera changed among the views of its label so much that this adds visibly
    to the scatter of their poses.

    One step from the common answer gives each view k the change c_k = vᵀ g_k / vᵀ S_k v of its own along a direction
    v of the camera's parameters: focal length, and the principal point's two. `variance` is that of c_k by noise alone.
    What print and lens model lack moves all c_k equally but for the robot's motion. So two things are asked of them:
    that they scatter by more than chance, and that the poses' scatter this makes is a share of the scatter there is.
    """
    unsteady = np.zeros(len(labels), dtype=np.bool_)
    rotations, centroids = placements.rotations, placements.translations_mm
    J = in_target_frame(rotations, centroids)
    positions = views.centroids - np.einsum("kji,kj->ki", rotations, centroids)
    for group in groups_of(labels * len(views.targets) + views.target):
        freedom = len(group) - 1
        if freedom < MIN_REPEATS - 1:
            continue
        turns = rotation_vectors(np.swapaxes(rotations[group], 1, 2), rotations[group[0]].T)
        seen = (np.trace(np.cov(positions[group].T)), np.trace(np.cov(turns.T)))
        beyond = max(MAX_DISAGREEMENT, float(chdtri(freedom, SIGNIFICANCE)) / freedom)
        for d, v in enumerate(camera_changes(placements.parameters[group[0]])):
            observed = np.einsum("i,kij,j->k", v, parts.S[group], v)
            if not np.all(observed > 0.0):
                continue
            change, information = parts.g[group] @ v / observed, 1.0 / variance[group, d]
            off = change - np.sum(change * information) / np.sum(information)
            if np.sum(information * off**2) / freedom <= beyond:
                continue
            excess = max(float(np.sum(off**2)) / freedom - float(np.mean(1.0 / information)), 0.0)
            moved = np.einsum("kij,kjl,l->ki", J[group], -parts.by_camera[group, -6:], v).mean(axis=0)
            made = (excess * float(moved[:3] @ moved[:3]), excess * float(moved[3:] @ moved[3:]))
            if any(one > MIN_VISIBLE_SHARE**2 * whole for one, whole in zip(made, seen, strict=True)):
                unsteady[group] = True
    return unsteady


def camera_changes(parameters: Float[np.ndarray, "*k s"]) -> Float[np.ndarray, "*k 3 c"]:
    """Return the directions in which cameras change: the focal length by its share, the principal point by pixels."""
    v = np.zeros((*parameters.shape[:-1], 3, free_parameters(parameters.shape[-1])))
    v[..., 0, :2] = parameters[..., :2]
    v[..., 1, 2] = v[..., 2, 3] = 1.0
    return v


def change_variances(
    parts: SchurBlocks, placements: Placements, noise: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k 3"]:
    """Return the variances of `camera_changes` seen by single views under white noise, noise² / vᵀ S v; infinite for
    what a view does not show.
    """
    v = camera_changes(placements.parameters)
    observed = np.einsum("kdi,kij,kdj->kd", v, parts.S, v)
    return np.where(observed > 0.0, noise[:, None] ** 2 / np.where(observed > 0.0, observed, 1.0), np.inf)


def score_test(
    S: Float[np.ndarray, "k c c"], g: Float[np.ndarray, "k c"], unit: Float[np.ndarray, "k c"]
) -> tuple[Float[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Return gᵀ S⁺ g and the rank of S, judged in units of `unit`."""
    values, vectors = np.linalg.eigh(S * unit[:, :, None] * unit[:, None, :])
    observable = values > MIN_EIGENVALUE
    along = np.einsum("kij,ki->kj", vectors, g * unit)
    gain = np.sum(np.where(observable, along**2 / np.where(observable, values, 1.0), 0.0), axis=1)
    return gain, observable.sum(axis=1)
