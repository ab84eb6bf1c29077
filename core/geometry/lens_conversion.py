"""A camera in the parameters of another lens model, and by how much its pixels differ there.

Models of different families have no common parameters: the other camera is the one whose pixels of the same directions
are nearest, in the mean square over a disc about the principal point. The largest difference over that disc is part of
the answer. Beyond it the two may differ by any amount.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.geometry.lens_inverse import MAX_FOLD_SHARE, fold_radius_px, undistort_any
from core.geometry.lens_models import (
    LENS_PARAMETERS,
    AnyCamera,
    LensModel,
    camera_from_array,
    lens_model_of,
    project_any,
    project_any_with_jacobian,
)

RINGS, SPOKES, BORDER = 24, 24, 24
_INNER = ("fx_px", "fy_px", "cx_px", "cy_px")


@dataclass(frozen=True, slots=True)
class Conversion:
    """A camera of another lens model, and how far a pixel of it lies from the original's at most (px), out to
    `radius_px` from the principal point; `largest_error_px` is infinite where it has no pixels there.
    """

    camera: AnyCamera
    largest_error_px: float
    radius_px: float


def convert_camera(
    camera: AnyCamera,
    model: LensModel,
    size_px: tuple[int, int],
    radius_px: float,
    absent: tuple[str, ...] = (),
) -> Conversion:
    """Return the camera of a lens model that is nearest to another.

    Parameters
    ----------
    size_px
        Width and height of the image; pixels outside do not count.
    radius_px
        Of the disc about the principal point over which the two are compared; at most `MAX_FOLD_SHARE` of the radius
        at which the given model turns back.
    absent
        Names of coefficients that the other format does not have; they are 0.
    """
    fold = fold_radius_px(camera)
    radius = radius_px if fold is None else min(radius_px, MAX_FOLD_SHARE * fold)
    names = LENS_PARAMETERS[model]
    own = dict(zip(LENS_PARAMETERS[lens_model_of(camera)], camera.as_array().tolist(), strict=True))
    kept = _INNER if lens_model_of(camera) != model else names
    start = np.array([own[name] if name in kept and name not in absent else 0.0 for name in names])
    if lens_model_of(camera) == model and not any(own[name] for name in absent):
        return Conversion(camera, 0.0, radius)
    if {lens_model_of(camera), model} == {"brown", "rational"}:
        # The rational model holds Brown's, and Brown's begins as it.
        start = np.array([own.get(name, 0.0) if name not in absent else 0.0 for name in names])
        if model == "rational":
            return Conversion(camera_from_array(start), 0.0, radius)
    free = np.array([name not in absent for name in names])
    directions, pixels = _seen(camera, size_px, radius, 0.0)
    found = camera_from_array(_nearest(start, free, directions, pixels))
    fine = _seen(camera, size_px, radius, 0.5)
    return Conversion(found, max(_largest(found, directions, pixels), _largest(found, *fine)), radius)


def _seen(
    camera: AnyCamera, size_px: tuple[int, int], radius: float, shift: float
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    """Return pixels of the disc that lie in the image, its rim and the image's border included, and directions."""
    r = radius * np.sqrt((np.arange(RINGS) + 1.0) / RINGS)
    angle = 2.0 * math.pi * (np.arange(SPOKES) + shift) / SPOKES
    places = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))], axis=-1).reshape(-1, 2)
    centre = np.array([camera.cx_px, camera.cy_px])
    places = np.concatenate([places + centre, _border(size_px, shift)])
    within = np.hypot(*(places - centre).T) <= radius * (1.0 + 1e-9)
    inside = within & np.all((places >= -0.5 - 1e-9) & (places <= np.array(size_px) - 0.5 + 1e-9), axis=1)
    normalised = undistort_any(places[inside], camera)
    sound = np.all(np.isfinite(normalised), axis=1)
    x, y = normalised[sound].T
    return np.column_stack([x, y, np.ones(len(x))]), places[inside][sound]


def _border(size_px: tuple[int, int], shift: float) -> Float[np.ndarray, "n 2"]:
    """Return pixels on the image's border, corners included."""
    width, height = size_px
    along = np.concatenate([[0.0], (np.arange(BORDER) + shift) / BORDER, [1.0]]) - 0.5
    u, v = width * along, height * along
    half_u, half_v = np.full(len(along), 0.5 * width), np.full(len(along), 0.5 * height)
    sides = [(u, -half_v), (u, half_v), (-half_u, v), (half_u, v)]
    middle = 0.5 * (np.array(size_px) - 1.0)
    return np.concatenate([np.column_stack(side) for side in sides]) + middle


def _nearest(
    start: Float[np.ndarray, " p"],
    free: Bool[np.ndarray, " p"],
    directions: Float[np.ndarray, "n 3"],
    pixels: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, " p"]:
    def whole(values: Float[np.ndarray, " q"]) -> Float[np.ndarray, " p"]:
        parameters = start.copy()
        parameters[free] = values
        return parameters

    def off(values: Float[np.ndarray, " q"]) -> Float[np.ndarray, " m"]:
        found, _, _ = project_any_with_jacobian(directions, camera_from_array(whole(values)))
        return np.asarray(np.nan_to_num(found - pixels.T, nan=1e6, posinf=1e6, neginf=-1e6).ravel())

    def slope(values: Float[np.ndarray, " q"]) -> Float[np.ndarray, "m q"]:
        _, by_camera, _ = project_any_with_jacobian(directions, camera_from_array(whole(values)))
        return np.asarray(np.nan_to_num(by_camera[free].reshape(int(free.sum()), -1).T))

    from scipy.optimize import least_squares  # takes a tenth of a second to load, and few processes convert

    best = least_squares(off, start[free], jac=slope, x_scale="jac", method="trf", max_nfev=200)
    return whole(best.x)


def _largest(
    camera: AnyCamera, directions: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"]
) -> float:
    """Return the largest distance of a direction's pixel from that given; infinite where the camera turns back."""
    if not len(pixels):
        return math.inf
    distances = np.linalg.norm(project_any(directions, camera) - pixels, axis=1)
    fold = fold_radius_px(camera)
    reach = float(np.max(np.linalg.norm(pixels - [camera.cx_px, camera.cy_px], axis=1)))
    if fold is not None and fold < reach:
        return math.inf
    largest = float(np.max(distances))
    return largest if math.isfinite(largest) else math.inf
