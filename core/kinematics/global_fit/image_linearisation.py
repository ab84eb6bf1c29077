"""Images linearised where lens and chain put them: poses with independent errors, and one lens in common.

With l a step of the lens, δ one of the image's pose, and

    [A  B] [l]   [a]
    [Bᵀ P] [δ] = [b]

the image's normal equations, the image says δ = P⁻¹ (b - Bᵀ l) with covariance P⁻¹, and of the lens what is left,
Λ = Σ (A - B P⁻¹ Bᵀ) + priors with the right-hand side Σ (a - B P⁻¹ b). To first order exactly, these are poses as
`PoseData` has them, their shared errors the lens's in independent standard deviations.

References: B. Triggs, P. McLauchlan, R. Hartley, A. Fitzgibbon, "Bundle adjustment: a modern synthesis", 1999,
section 6.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration import (
    Lens,
    Placements,
    VarianceInflation,
    ViewStack,
    camera_prior,
    coordinates,
    in_target_frame,
    linearise,
    transformed,
)
from core.errors import DegenerateGeometry
from core.geometry import rotations_from_vectors
from core.kinematics.pose_observations import PoseData
from core.numerics import root_of_inverse

_NO_GROWTH = VarianceInflation(1.0, 1.0)
_MIN_EIGENVALUE = 1e-14
"""Smallest eigenvalue of a pose's scaled information: below it, rounding dominates."""


@dataclass(frozen=True, slots=True)
class ImageObservations:
    """Observations of images without their poses: grid points and which of them are used, the noise's `scale` per unit
    of stated uncertainty, a prior on the lens, joint angles (rad), the target that each image shows, labels.
    """

    views: ViewStack
    used: Bool[np.ndarray, " n"]
    scale: float
    lens: Lens | None
    joint_angles: Float[np.ndarray, "k j"]
    target: Int[np.ndarray, " k"]
    labels: tuple[str, ...]
    growth: VarianceInflation = _NO_GROWTH
    """Of the variances of lens and places, where residuals are more than noise: a print that is not flat, a lens beyond
    its model."""
    approach: Float[np.ndarray, "k j"] | None = None
    """As of `PoseData`."""


@dataclass(frozen=True, slots=True)
class ImagePoses:
    """Images linearised: their poses at the lens that they find best, which is a `step` from the one they were
    linearised at, and the `root` of its covariance: the first shared errors, as many, are in its columns' units.
    """

    poses: PoseData
    step: Float[np.ndarray, " c"]
    root: Float[np.ndarray, "c c"]


def linearise_images(seen: ImageObservations, placements: Placements) -> ImagePoses:
    """Linearise the images at their places."""
    at = linearise(seen.views, placements, seen.used)
    parameters = placements.parameters[0]
    of_camera = coordinates(parameters)
    c = len(of_camera)
    change = np.eye(c + 6)
    change[:c, :c] = of_camera
    N = change.T @ at.normal @ change / seen.scale**2
    g = at.gradient @ change / seen.scale**2
    A, B, P = N[:, :c, :c], N[:, :c, c:], N[:, c:, c:]
    _require_poses(P)
    own = np.linalg.inv(P)
    own = 0.5 * (own + own.transpose(0, 2, 1))
    back = B @ own
    width, height = seen.views.image_width_px, seen.views.image_height_px
    q, Q = camera_prior(width, height, seen.lens, model_size=len(parameters))(parameters)
    Q = Q @ of_camera
    information = (A - back @ B.transpose(0, 2, 1)).sum(axis=0) + Q.T @ Q
    step = np.linalg.solve(
        information, (g[:, :c] - np.einsum("kab,kb->ka", back, g[:, c:])).sum(axis=0) + Q.T @ q
    )
    root = _root(information) * math.sqrt(seen.growth.camera)
    motion = np.einsum("kab,kb->ka", own, g[:, c:] - np.einsum("kab,a->kb", B, step))
    rotations = rotations_from_vectors(motion[:, :3]) @ placements.rotations
    centroids = placements.translations_mm + motion[:, 3:]
    J = in_target_frame(rotations, centroids)
    positions = seen.views.centroids - np.einsum("kji,kj->ki", rotations, centroids)
    common = J @ back.transpose(0, 2, 1) @ root
    poses = PoseData(
        seen.joint_angles,
        positions,
        np.ascontiguousarray(rotations.transpose(0, 2, 1)),
        transformed(J, own) * seen.growth.own,
        np.concatenate([common, _prints(seen, positions)], axis=2),
        seen.target,
        seen.labels,
        approach=seen.approach,
    )
    return ImagePoses(poses, step, root)


def _require_poses(information: Float[np.ndarray, "k 6 6"]) -> None:
    """Raise DegenerateGeometry where an image does not determine its own pose."""
    unit = np.sqrt(np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-300))
    scaled = information / (unit[:, :, None] * unit[:, None, :])
    if not np.isfinite(information).all() or np.linalg.eigvalsh(scaled)[:, 0].min() < _MIN_EIGENVALUE:
        raise DegenerateGeometry(
            "Some images do not determine the camera's pose: their grid points lie too close together, or on a line.",
            "Show more of the grid, larger in the image.",
        )


def _root(information: Float[np.ndarray, "c c"]) -> Float[np.ndarray, "c c"]:
    """Return a root of the inverse: standard deviations of independent errors."""
    diagonal = np.diag(information)
    if not (np.isfinite(information).all() and np.all(diagonal > 0.0)):
        raise DegenerateGeometry(
            "The images do not determine the lens: all of them see the grid from one direction.",
            "Tilt the camera against the grid, and move more than one joint.",
        )
    return root_of_inverse(information)


def _prints(seen: ImageObservations, positions: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 6 t"]:
    """Return what one standard uncertainty of each print's scale does to poses, for prints that state one."""
    columns = []
    for target in np.unique(seen.target):
        members = seen.target == target
        spec = seen.views.targets[int(seen.views.target[int(np.argmax(members))])]
        if spec.scale_standard_uncertainty:
            column = np.zeros((len(positions), 6))
            column[members, :3] = positions[members] * spec.scale_standard_uncertainty
            columns.append(column)
    return np.stack(columns, axis=2) if columns else np.zeros((len(positions), 6, 0))
