"""Normal equations of bundle adjustment over camera, poses and the target's points, poses eliminated.

Unknowns are the camera's parameters c (nine with Brown's lens model, k3 too: its effect on a wide lens's images
otherwise looks like a bow; ten with Kannala's and Brandt's, twelve with the rational one), the deviations s of the grid
points from where they were meant to be (3 a point, target frame, mm) and a pose for each view. With z = (c, s) and a
view's pose l,

    [N_zz N_zl] [z]   [b_z]
    [N_lz N_ll] [l] = [b_l],      S = N_zz - Σ N_zl N_ll⁻¹ N_lz,      l = N_ll⁻¹ (b_l - N_lz z),

so that a view adds a matrix of rank six to what its points add to 3 × 3 blocks.

References: B. Triggs, P. McLauchlan, R. Hartley, A. Fitzgibbon, "Bundle adjustment: a modern synthesis", 1999, §6.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.geometry import camera_from_array, project_any_with_jacobian, so3_exp
from core.numerics import REJECTION


@dataclass(frozen=True, slots=True)
class SeenPoints:
    """One view: which of the target's points (by their place in the state) it shows, where, and how sure (px)."""

    place: Int[np.ndarray, " n"]
    points_px: Float[np.ndarray, "n 2"]
    standard_uncertainty_px: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class ShapeState:
    """Camera parameters, T_camera_target of every view as rotation and translation about the target's middle, and the
    points' places about that middle (target frame, mm).
    """

    parameters: Float[np.ndarray, " c"]
    rotations: Float[np.ndarray, "m 3 3"]
    translations_mm: Float[np.ndarray, "m 3"]
    points_mm: Float[np.ndarray, "n 3"]

    def moved(self, z: Float[np.ndarray, " z"], poses: Float[np.ndarray, "m 6"]) -> ShapeState:
        """Take a step: R ← exp(w) R, t ← t + d."""
        of_camera = len(self.parameters)
        parameters = self.parameters + z[:of_camera]
        rotations = np.array([so3_exp(w) @ R for w, R in zip(poses[:, :3], self.rotations, strict=True)])
        points = self.points_mm + z[of_camera:].reshape(-1, 3)
        return ShapeState(parameters, rotations, self.translations_mm + poses[:, 3:], points)


@dataclass(frozen=True, slots=True)
class Normals:
    """The system at a state, at unit scale: `information` S and `gradient` of z, and what gives the poses back."""

    information: Float[np.ndarray, "z z"]
    gradient: Float[np.ndarray, " z"]
    of_poses: Float[np.ndarray, "m 6 z"]
    pose_steps: Float[np.ndarray, "m 6"]
    residuals: tuple[Float[np.ndarray, "2 _"], ...]
    """Observed - predicted, in stated uncertainties; of all points, used or not."""

    def poses(self, z: Float[np.ndarray, " z"]) -> Float[np.ndarray, "m 6"]:
        """Return the poses' steps that go with a step z."""
        return np.asarray(self.pose_steps - self.of_poses @ z)


def residuals_at(state: ShapeState, views: Sequence[SeenPoints]) -> tuple[Float[np.ndarray, "2 _"], ...]:
    """Return observed - predicted of every view, in stated uncertainties."""
    camera = camera_from_array(state.parameters)
    found = []
    for view, R, t in zip(views, state.rotations, state.translations_mm, strict=True):
        pixels, _, _ = project_any_with_jacobian(state.points_mm[view.place] @ R.T + t, camera)
        found.append((view.points_px.T - pixels) / view.standard_uncertainty_px)
    return tuple(found)


def normals_at(
    state: ShapeState, views: Sequence[SeenPoints], weights: Sequence[Float[np.ndarray, " _"]]
) -> Normals:
    """Linearise; `weights` from 0 to 1 for every point of every view."""
    camera = camera_from_array(state.parameters)
    count, of_camera = len(state.points_mm), len(state.parameters)
    size = of_camera + 3 * count
    S, b = np.zeros((size, size)), np.zeros(size)
    blocks = np.zeros((count, 3, 3))
    of_poses, pose_steps = np.empty((len(views), 6, size)), np.empty((len(views), 6))
    residuals = []
    for k, (view, weight) in enumerate(zip(views, weights, strict=True)):
        R = state.rotations[k]
        turned = state.points_mm[view.place] @ R.T
        pixels, by_camera, by_point = project_any_with_jacobian(turned + state.translations_mm[k], camera)
        root = np.sqrt(weight) / view.standard_uncertainty_px
        r = (view.points_px.T - pixels) / view.standard_uncertainty_px
        residuals.append(r)
        weighted = (r * np.sqrt(weight)).ravel()
        c = (by_camera * root).reshape(of_camera, -1)
        by_translation = by_point * root
        by_rotation = np.cross(turned.T[:, None, :], by_translation, axis=0)  # d(exp(w) R x)/dw = w × (R x)
        pose = np.concatenate([by_rotation, by_translation]).reshape(6, -1)
        by_place = np.einsum("ji,jmn->imn", R, by_translation)
        S[:of_camera, :of_camera] += c @ c.T
        b[:of_camera] += c @ weighted
        columns = of_camera + 3 * view.place[:, None] + np.arange(3)
        both = np.concatenate([c, pose]).reshape(of_camera + 6, 2, -1)
        across = np.einsum("amn,imn->nai", both, by_place)
        S[:of_camera, columns.ravel()] += np.swapaxes(across[:, :of_camera], 0, 1).reshape(of_camera, -1)
        b[columns] += np.einsum("imn,mn->ni", by_place, r * np.sqrt(weight))
        blocks[view.place] += np.einsum("imn,jmn->nij", by_place, by_place)
        of_pose = np.zeros((6, size))
        of_pose[:, :of_camera] = pose @ c.T
        of_pose[:, columns.ravel()] = np.swapaxes(across[:, of_camera:], 0, 1).reshape(6, -1)
        lower = np.linalg.cholesky(pose @ pose.T)
        of_poses[k] = np.linalg.solve(lower, of_pose)
        pose_steps[k] = np.linalg.solve(lower, pose @ weighted)
        b -= of_poses[k].T @ pose_steps[k]
        pose_steps[k] = np.linalg.solve(lower.T, pose_steps[k])
        S -= of_poses[k].T @ of_poses[k]
        of_poses[k] = np.linalg.solve(lower.T, of_poses[k])
    S[of_camera:, :of_camera] = S[:of_camera, of_camera:].T
    diagonal = of_camera + 3 * np.arange(count)[:, None] + np.arange(3)
    S[diagonal[:, :, None], diagonal[:, None, :]] += blocks
    return Normals(S, b, of_poses, pose_steps, tuple(residuals))


def inliers_of(residuals: Sequence[Float[np.ndarray, "2 _"]]) -> tuple[Bool[np.ndarray, " _"], ...]:
    """Return which points of each view lie within the rejection's distance of that view's median."""
    found = []
    for r in residuals:
        distance = np.hypot(*r)
        found.append(distance <= REJECTION * max(float(np.median(distance)), 1e-3))
    return tuple(found)


def sum_of_squares(
    residuals: Sequence[Float[np.ndarray, "2 _"]], used: Sequence[Bool[np.ndarray, " _"]]
) -> float:
    """Return the sum of squared residuals over the points used, in stated uncertainties."""
    return float(sum(np.sum(r[:, u] ** 2) for r, u in zip(residuals, used, strict=True)))


def rms_px_of(
    views: Sequence[SeenPoints],
    residuals: Sequence[Float[np.ndarray, "2 _"]],
    used: Sequence[Bool[np.ndarray, " _"]],
) -> float:
    """Return the root mean square of the residual distances, px."""
    squares = [
        np.sum((r * v.standard_uncertainty_px)[:, u] ** 2)
        for v, r, u in zip(views, residuals, used, strict=True)
    ]
    return math.sqrt(float(sum(squares)) / max(sum(int(u.sum()) for u in used), 1))
