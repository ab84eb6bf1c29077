"""What views say of a camera, their poses unknown; and what a camera's uncertainty means in pixels.

With l a step of the camera, δ one of a view's pose, and the view's normal equations [A B; Bᵀ P], the view says
Λ = A - B P⁻¹ Bᵀ of the camera whatever its pose. Of independent views these add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.calibration import (
    Placements,
    ViewStack,
    in_target_frame,
    linearise,
    stack_views,
    transformed,
)
from core.geometry import (
    AnyCamera,
    camera_from_array,
    project_any,
    transform_points,
    undistort_any,
)
from core.targets import GridPoints, TargetSpec

_ACROSS = 9
_STEP = 1e-5


@dataclass(frozen=True, slots=True)
class ViewInformation:
    """What n views say of their camera, c free parameters, and of where it stands.

    `camera` is Λ. `own` is the covariance of the camera's pose in the target frame (mm, rad) at a known camera, and
    `by_camera` how that pose moves with the camera's parameters.
    """

    camera: Float[np.ndarray, "n c c"]
    own: Float[np.ndarray, "n 6 6"]
    by_camera: Float[np.ndarray, "n 6 c"]


def view_information(views: ViewStack, placements: Placements) -> ViewInformation:
    """Return what views say, for points of the noise that they state."""
    used = np.ones(len(views.column), dtype=np.bool_)
    N = linearise(views, placements, used).normal
    c = N.shape[1] - 6
    A, B, P = N[:, :c, :c], N[:, :c, c : c + 6], N[:, c : c + 6, c : c + 6]
    moved = np.linalg.solve(P, B.transpose(0, 2, 1))
    J = in_target_frame(placements.rotations, placements.translations_mm)
    return ViewInformation(
        A - B @ moved,
        transformed(J, np.linalg.inv(P)),
        -J @ moved,
    )


def camera_information(views: ViewStack, placements: Placements) -> Float[np.ndarray, "k c c"]:
    """Return Λ of every view, by the free parameters of the camera (its model's `LENS_PARAMETERS`), for points of the
    noise that they state.
    """
    return view_information(views, placements).camera


def simulated_views(
    spec: TargetSpec,
    camera: AnyCamera,
    size_px: tuple[int, int],
    T_camera_target: Float[np.ndarray, "n 4 4"],
    noise_px: float,
    rng: np.random.Generator | None = None,
) -> list[GridPoints]:
    """Return what a detector of this noise would find; exact points without `rng`."""
    points = spec.points_target()
    found = []
    for T in T_camera_target:
        pixels = np.ascontiguousarray(project_any(transform_points(T, points), camera))
        if rng is not None:
            pixels = pixels + rng.normal(0.0, noise_px, pixels.shape)
        found.append(GridPoints.whole(spec, size_px, pixels, noise_px))
    return found


def placed_views(
    views: Sequence[GridPoints], camera: AnyCamera, T_camera_target: Float[np.ndarray, "n 4 4"]
) -> tuple[ViewStack, Placements]:
    """Return views with the states that they were taken in."""
    stack = stack_views(list(views))
    rotations = np.ascontiguousarray(T_camera_target[:, :3, :3])
    centroids = np.einsum("kij,kj->ki", rotations, stack.centroids) + T_camera_target[:, :3, 3]
    return stack, Placements(np.tile(camera.as_array(), (len(views), 1)), rotations, centroids)


def projection_jacobian(camera: AnyCamera, size_px: tuple[int, int], free: int) -> Float[np.ndarray, "m c"]:
    """Return the derivatives of pixels over the whole image, at fixed directions, by the camera's free parameters."""
    u, v = (np.linspace(0.0, size - 1.0, _ACROSS) for size in size_px)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    normalised = undistort_any(pixels, camera)
    normalised = normalised[np.isfinite(normalised).all(axis=1)]
    directions = np.column_stack([normalised, np.ones(len(normalised))])
    parameters = camera.as_array()
    columns = []
    for k in range(free):
        step = _STEP * max(abs(float(parameters[k])), 1.0)
        ends = []
        for sign in (1.0, -1.0):
            moved = parameters.copy()
            moved[k] += sign * step
            ends.append(project_any(directions, camera_from_array(moved)).ravel())
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    return np.array(columns).T
