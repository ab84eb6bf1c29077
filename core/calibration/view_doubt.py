"""From the normal matrices of many views to the covariances of their poses: what scatters, and what all have in common.

A view's own coordinates l (its pose and what else it has by itself) have the data's information N and the priors' P, so
that the estimate's covariance about the truth is C = (N + P)⁻¹. Repeated, the same view's estimates scatter about their
own mean by C N C only: where a prior pulls all of them the same way, it makes no scatter. Without priors both are N⁻¹.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.model import SMALLEST_NOISE_PX
from core.targets.specification import GridPoints

LEAST_FREEDOM = 200
"""Degrees of freedom below which images of one pose do not tell their noise by themselves."""
SMALLEST_EIGENVALUE = 1e-10
"""Of the camera's normal matrix scaled to unit diagonal: below it a view says nothing of that combination."""


def pose_covariances(
    N: Float[np.ndarray, "k l l"], P: Float[np.ndarray, "k l l"]
) -> tuple[Float[np.ndarray, "k 6 6"], Float[np.ndarray, "k 6 6"]]:
    """Return (C, C N C) of the last six coordinates, a pose."""
    C = np.linalg.inv(N + P)
    C = 0.5 * (C + np.swapaxes(C, 1, 2))
    scatter = C @ N @ C
    return C[:, -6:, -6:], scatter[:, -6:, -6:]


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


def transformed(J: Float[np.ndarray, "k a b"], C: Float[np.ndarray, "k b b"]) -> Float[np.ndarray, "k a a"]:
    """Return J C Jᵀ, symmetric to the last bit."""
    result = J @ C @ np.swapaxes(J, 1, 2)
    return np.asarray(0.5 * (result + np.swapaxes(result, 1, 2)))


def repeated_scales(
    views: Sequence[GridPoints],
    residuals: Sequence[Float[np.ndarray, "2 _"]],
    used: Sequence[Bool[np.ndarray, " _"]],
    labels: Sequence[Hashable],
    parameters: int,
    otherwise: float,
) -> Float[np.ndarray, " k"]:
    """Return σ per unit of stated uncertainty for every view, from residuals about the mean of the views of its label.

    `parameters` each view has of its own; `otherwise` is for where there are no repeated views. Never below what
    `SMALLEST_NOISE_PX` is of the uncertainty: one image stored many times has no noise, which no instrument has.
    """
    members: dict[Hashable, list[int]] = {}
    for i, label in enumerate(labels):
        members.setdefault((label, views[i].column.tobytes(), views[i].row.tobytes()), []).append(i)
    squares = {key: _about_mean(views, residuals, used, group, parameters) for key, group in members.items()}
    total, freedom = (sum(part) for part in zip(*squares.values(), strict=True))
    common = float(np.sqrt(total / freedom)) if freedom >= LEAST_FREEDOM else otherwise
    scales = np.empty(len(views))
    for key, group in members.items():
        square, of_label = squares[key]
        scale = float(np.sqrt(square / of_label)) if of_label >= LEAST_FREEDOM else common
        scales[group] = max(scale, SMALLEST_NOISE_PX / float(views[group[0]].standard_uncertainty_px.mean()))
    return scales


def _about_mean(
    views: Sequence[GridPoints],
    residuals: Sequence[Float[np.ndarray, "2 _"]],
    used: Sequence[Bool[np.ndarray, " _"]],
    group: list[int],
    parameters: int,
) -> tuple[float, int]:
    """Return the sum of squares about the mean, in stated uncertainties, and its degrees of freedom."""
    everywhere = np.all([used[i] for i in group], axis=0)
    freedom = (len(group) - 1) * (2 * int(everywhere.sum()) - parameters)
    if freedom <= 0:
        return 0.0, 0
    uncertainty = np.mean([views[i].standard_uncertainty_px[everywhere] for i in group], axis=0)
    stack = np.array([residuals[i][:, everywhere] for i in group]) / uncertainty
    return float(np.sum((stack - stack.mean(axis=0)) ** 2)), freedom


def disagreement(
    normal: Float[np.ndarray, "k 14 14"],
    gradient: Float[np.ndarray, "k 14"],
    squares: Float[np.ndarray, " k"],
    observations: Float[np.ndarray, " k"],
    own: Float[np.ndarray, "k 14 l"],
    common: int,
) -> float | None:
    """Return how far views contradict a common camera, 1 being what chance makes; None where there is nothing to tell.

    One step from the common answer toward a camera of its own lessens a view's squared residuals by gᵀ S⁺ g, with S and
    g the camera's part of the view's normal equations after what the view has of its own is eliminated (Rao's score
    test); over the noise variance that the view's residuals leave, that is χ² with rank(S) degrees of freedom if the
    camera is right. The sum over views is compared with its expectation, `common` parameters having been fitted.
    """
    transposed = np.swapaxes(own, 1, 2)
    L, C = transposed @ normal @ own, transposed @ normal[:, :, :8]
    S = normal[:, :8, :8] - np.swapaxes(C, 1, 2) @ np.linalg.solve(L, C)
    of_own = np.linalg.solve(L, transposed @ gradient[..., None])
    g = gradient[:, :8] - (np.swapaxes(C, 1, 2) @ of_own)[..., 0]
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2)[:, :8], 1e-300))
    values, vectors = np.linalg.eigh(S * unit[:, :, None] * unit[:, None, :])
    told = values > SMALLEST_EIGENVALUE
    along = np.einsum("kij,ki->kj", vectors, g * unit)
    gain = np.sum(np.where(told, along**2 / np.where(told, values, 1.0), 0.0), axis=1)
    rank = told.sum(axis=1)
    left = observations - own.shape[2] - rank
    enough = left > 0
    if not enough.any() or int(rank[enough].sum()) <= common:
        return None
    variance = np.maximum(squares - gain, 1e-12 * squares + 1e-300) / np.maximum(left, 1.0)
    return float(np.sum((gain / variance)[enough]) / (int(rank[enough].sum()) - common))
