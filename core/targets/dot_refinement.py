"""Dots at full resolution: where their centres' pictures are, and how sure that is.

Each dot is fitted by `dot_kernel`. The centre of a dot's picture is not the picture of its centre: perspective and lens
shift it, by a pixel for large dots near the edge of a tilted board. How far depends on the map from the target plane to
the picture alone, not on focal length or pose, and that map is told by the dots themselves (`grid_map`). So it is
corrected here, once, for every estimator: the dot's outline is put through the map, the ellipse that fits it as the
pixels' does is found, and its centre compared with the picture of the dot's centre.

References: J. Heikkilä, O. Silvén, "A four-step camera calibration procedure with implicit image correction", CVPR
1997, section 3.2 (the shift under perspective), doi:10.1109/CVPR.1997.609468.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.targets.dot_kernel import fit_dot
from core.targets.dots import Dots
from core.targets.grid_map import grid_basis, grid_shape
from core.targets.pyramid import Level

ODD = 0.25  # by how much, of the others' radius, a dot is larger or smaller that is not one of them
LEAST_DOTS = 8
_SMALL_PX = 8.0
_FIRST_DOUBTS, _LATER_DOUBTS = (0.7, 0.7), (0.1, 0.2)  # of shape and blur, see `dot_kernel.fit_dot`
_OUTLINE = 16  # places on a dot's outline
_CORRECTIONS = 4
_SETTLED_PX = 5e-4
_MOST_STEPS = 12
_TOLERANCE = 0.2  # of the uncertainty: the next step would be a tenth of that
_START_BLUR_PX, _LEAST_BLUR_PX = 1.5, 0.25
_ASTRAY = 6.0


@dataclass(frozen=True, slots=True)
class FittedDots:
    """Dots at full resolution: `shapes` as `dot_kernel` has them, residual variances, centres' covariances for a
    variance of one, contrasts (positive), and which of them were fitted at all."""

    shapes: Float[np.ndarray, "n 6"]
    variance: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n 2 2"]
    contrast: Float[np.ndarray, " n"]
    trusted: Bool[np.ndarray, " n"]

    @property
    def radius_px(self) -> Float[np.ndarray, " n"]:
        """The mean radius, of the circle with the ellipse's area."""
        s = self.shapes
        return np.asarray((s[:, 2] * s[:, 4] - s[:, 3] ** 2) ** -0.25)


def fit_dots(
    image: Shaped[np.ndarray, "h w"],
    level: Level,
    dots: Dots,
    which: Int[np.ndarray, " n"],
    ideal: Float[np.ndarray, "n 2"],
) -> FittedDots:
    """Fit dots at full resolution, small ones again from where and how the others say they must be.

    Parameters
    ----------
    image
        The full picture, in one piece and writeable.
    level, dots, which
        Where they were found: those of `dots` on `level`.
    ideal
        Their places on the print, pitches.
    """
    scale = float(1 << level.halvings)
    M = np.linalg.inv(4.0 * dots.moments[which] * scale**2)
    start = np.column_stack(
        [
            level.to_full(dots.centres[which]),
            M[:, 0, 0],
            M[:, 0, 1],
            M[:, 1, 1],
            np.full(len(M), _START_BLUR_PX),
        ]
    )
    fitted = _fit_from(image, start, dots.are_dark, _FIRST_DOUBTS)
    if fitted.trusted.all() and float(np.median(fitted.radius_px)) > _SMALL_PX:
        return fitted
    expected = _expected(fitted, ideal)
    return fitted if expected is None else _fit_from(image, expected, dots.are_dark, _LATER_DOUBTS)


def _fit_from(
    image: Shaped[np.ndarray, "h w"],
    start: Float[np.ndarray, "n 6"],
    are_dark: bool,
    doubts: tuple[float, float],
) -> FittedDots:
    count = len(start)
    shapes, variance = start.copy(), np.zeros(count)
    covariance, contrast = np.zeros((count, 2, 2)), np.zeros(count)
    trusted = np.zeros(count, dtype=np.bool_)
    for n in range(count):
        shape, light, covariance[n], variance[n], trusted[n] = fit_dot(
            image, start[n], _LEAST_BLUR_PX, _MOST_STEPS, _TOLERANCE, *doubts
        )
        contrast[n] = -light[3] if are_dark else light[3]
        if trusted[n]:
            shapes[n] = shape
    return FittedDots(shapes, variance, covariance, contrast, trusted & (contrast > 0.0))


def _expected(fitted: FittedDots, ideal: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 6"] | None:
    """Return what each dot should look like by the others: place and foreshortening by the map they make, the radius on
    the print and the blur most have. None where too few say anything."""
    trusted = fitted.trusted
    if trusted.sum() < LEAST_DOTS:
        return None
    J, places = plane_map(ideal, fitted.shapes[:, :2], trusted.astype(np.float64))
    ratio = fitted.radius_px / np.sqrt(np.abs(np.linalg.det(J)))
    usual = float(np.median(ratio[trusted]))
    ratio = np.where(trusted & (np.abs(ratio / usual - 1.0) > ODD), ratio, usual)  # one may mark the origin
    A = np.linalg.inv(J * ratio[:, None, None])
    M = np.einsum("nki,nkj->nij", A, A)
    blur = float(np.clip(np.median(fitted.shapes[trusted, 5]), _LEAST_BLUR_PX, None))
    return np.column_stack([places, M[:, 0, 0], M[:, 0, 1], M[:, 1, 1], np.full(len(M), blur)])


def plane_map(
    ideal: Float[np.ndarray, "n 2"], places: Float[np.ndarray, "n 2"], weights: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, "n 2"]]:
    """Return the map's Jacobians at the dots, px per grid unit, and where it puts them."""
    shape = grid_shape(grid_basis(ideal, places, weights), places, weights)
    return np.stack([shape.along_x, shape.along_y], axis=2), shape.points_px


def corrected_centres(
    ideal: Float[np.ndarray, "n 2"], fitted: FittedDots
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Return the pictures of the dots' centres, and which dots agree with the map they make."""
    count = len(ideal)
    angle = np.arange(_OUTLINE) * (2.0 * np.pi / _OUTLINE)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    measured, trusted = fitted.shapes[:, :2], fitted.trusted
    shift = np.zeros((count, 2))
    J, _ = plane_map(ideal, measured, trusted.astype(np.float64))
    for _ in range(_CORRECTIONS):
        centres = measured - shift
        radius = fitted.radius_px / np.sqrt(np.abs(np.linalg.det(J)))
        places = np.concatenate([ideal, (ideal[:, None, :] + radius[:, None, None] * ring).reshape(-1, 2)])
        known = np.concatenate([centres, np.repeat(centres, _OUTLINE, axis=0)])
        weights = np.concatenate([trusted.astype(np.float64), np.zeros(count * _OUTLINE)])
        all_J, drawn = plane_map(places, known, weights)
        J = all_J[:count]
        off = np.hypot(*(centres - drawn[:count]).T)
        usual = 1.4826 * float(np.median(off[trusted])) if trusted.any() else 0.0
        trusted = trusted & (off <= _ASTRAY * max(usual, 0.01))
        outline = drawn[count:].reshape(count, _OUTLINE, 2)
        renewed = _ellipse_centres(outline, drawn[:count], J * radius[:, None, None], ring)
        moved = float(np.max(np.abs(renewed - shift)))
        shift = renewed
        if moved < _SETTLED_PX:
            break
    return measured - shift, trusted


def _ellipse_centres(
    outline: Float[np.ndarray, "n k 2"],
    centres: Float[np.ndarray, "n 2"],
    A: Float[np.ndarray, "n 2 2"],
    ring: Float[np.ndarray, "k 2"],
) -> Float[np.ndarray, "n 2"]:
    """Return how far the centres of the ellipses that fit outlines lie from the pictures of the dots' centres.

    One Gauss-Newton step from the ellipse centre + A n: distances along the edge's normal, weighted by the length of
    edge each place stands for, since pixels all along it tell the ellipse equally.
    """
    departure = outline - centres[:, None, :] - np.einsum("nij,kj->nki", A, ring)
    normal = np.einsum("nij,kj->nki", np.linalg.inv(A).transpose(0, 2, 1), ring)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    tangent = np.stack([-ring[:, 1], ring[:, 0]], axis=1)
    weight = np.linalg.norm(np.einsum("nij,kj->nki", A, tangent), axis=2)
    value = np.einsum("nki,nki->nk", departure, normal)
    c, s = ring.T
    shapes = [
        np.stack([c, np.zeros_like(c)], axis=1),
        np.stack([s, c], axis=1),
        np.stack([np.zeros_like(s), s], axis=1),
    ]
    basis = [normal[..., 0], normal[..., 1]]
    basis += [np.einsum("nki,nij,kj->nk", normal, A, shape) for shape in shapes]
    B = np.stack(basis, axis=2)
    N = np.einsum("nki,nk,nkj->nij", B, weight, B)
    g = np.einsum("nki,nk,nk->ni", B, weight, value)
    return np.asarray(np.linalg.solve(N, g[..., None])[:, :2, 0])
