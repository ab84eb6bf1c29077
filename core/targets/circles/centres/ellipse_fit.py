"""Measure dots at full resolution: ellipses fitted to their images by `ellipse_solver`, with covariances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.targets.circles.blobs import Dots
from core.targets.circles.centres.ellipse_solver import fit_each
from core.targets.lattice import Level
from core.targets.subpixel import grid_basis, grid_shape, levels_between

ODD = 0.25  # by how much, of the others' radius, a dot is larger or smaller that is not one of them
MIN_DOTS = 8
_SMALL_PX = 8.0
_FIRST_PRIOR_SIGMAS = (0.7, 0.7)  # of shape and blur, see `ellipse_solver.fit_dot`
_LATER_PRIOR_SIGMAS = (0.1, 0.2)
_ROUND_TRIP = 24  # places on a dot's outline
_MIN_LEFT = 0.25  # of what repeats itself: with less left by blur it is not determined
_MAX_STEPS = 12
_TOLERANCE = 0.2  # of the uncertainty: the next step would be a tenth of that
_START_BLUR_PX, _MIN_BLUR_PX = 1.5, 0.25


@dataclass(frozen=True, slots=True)
class FittedDots:
    """Dots at full resolution: `shapes` as `ellipse_model` has them, residual variances, centres' covariances for a
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


def step_variance(fitted: FittedDots) -> Float[np.ndarray, " n"]:
    """Return the variances (px²) of the centres of dots whose edges go in steps of whole pixels, as a threshold leaves
    them; 0 for the others.

    Such an edge has less blur than a pixel's own area gives. Each pixel along it is off by up to half a pixel, with a
    variance of 1/12; each of the centre's coordinates rests on half of the 2 π r pixels.
    """
    return np.where(fitted.shapes[:, 5] <= _MIN_BLUR_PX, 1.0 / (12.0 * np.pi * fitted.radius_px), 0.0)


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
        The full image, contiguous and writeable.
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
    fitted = _fit_from(image, start, dots.are_dark, _FIRST_PRIOR_SIGMAS)
    if fitted.trusted.all() and float(np.median(fitted.radius_px)) > _SMALL_PX:
        return fitted
    expected = _expected(fitted, ideal)
    return fitted if expected is None else _fit_from(image, expected, dots.are_dark, _LATER_PRIOR_SIGMAS)


def fourth_harmonic_share(image: Shaped[np.ndarray, "h w"], fitted: FittedDots) -> float:
    """Return how square the dots are: the part of their grey levels, along the fitted ellipses, that repeats itself at
    every quarter turn, of their contrast; the same way round on all dots, as on a grille's."""
    ring = 2.0 * np.pi * np.arange(_ROUND_TRIP) / _ROUND_TRIP
    levels = levels_between(image, *outlines(fitted.shapes[fitted.trusted]))
    fourfold = levels @ np.exp(4.0j * ring) / _ROUND_TRIP
    # rad per px along the outline, of which blur leaves exp(-(k s)²/2)
    waves = 4.0 / fitted.radius_px[fitted.trusted]
    left = np.maximum(np.exp(-0.5 * (waves * fitted.shapes[fitted.trusted, 5]) ** 2), _MIN_LEFT)
    return float(abs(np.mean(fourfold / (left * fitted.contrast[fitted.trusted]))))


def outlines(
    shapes: Float[np.ndarray, "n 6"], outside_px: Float[np.ndarray, " n"] | None = None
) -> tuple[Float[np.ndarray, "n k"], Float[np.ndarray, "n k"]]:
    """Return places all around the dots' outlines, or so far outside; inside, half-way to the centre at most."""
    a, b, c = shapes[:, 2:5].T
    root = np.sqrt(a * c - b * b)
    norm = root * np.sqrt(a + c + 2.0 * root)  # M^(-1/2) = (M's adjugate + √det) / that
    ring = 2.0 * np.pi * np.arange(_ROUND_TRIP) / _ROUND_TRIP
    x, y = np.cos(ring), np.sin(ring)
    u = ((c + root) / norm)[:, None] * x - (b / norm)[:, None] * y
    v = ((a + root) / norm)[:, None] * y - (b / norm)[:, None] * x
    if outside_px is not None:
        longer = np.maximum(1.0 + outside_px[:, None] / np.hypot(u, v), 0.5)
        u, v = longer * u, longer * v
    return shapes[:, :1] + u, shapes[:, 1:2] + v


def _fit_from(
    image: Shaped[np.ndarray, "h w"],
    start: Float[np.ndarray, "n 6"],
    are_dark: bool,
    prior_sigmas: tuple[float, float],
) -> FittedDots:
    count = len(start)
    shapes, variance = start.copy(), np.zeros(count)
    covariance, contrast = np.zeros((count, 2, 2)), np.zeros(count)
    trusted = np.zeros(count, dtype=np.bool_)
    found = shapes, contrast, covariance, variance, trusted
    fit_each(image, start, _MIN_BLUR_PX, _MAX_STEPS, _TOLERANCE, *prior_sigmas, *found)
    shapes[~trusted] = start[~trusted]
    if are_dark:
        contrast = -contrast
    return FittedDots(shapes, variance, covariance, contrast, trusted & (contrast > 0.0))


def _expected(fitted: FittedDots, ideal: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 6"] | None:
    """Return what each dot should look like by the others: place and foreshortening by the map they make, the radius on
    the print and the blur most have. None where too few say anything."""
    trusted = fitted.trusted
    if trusted.sum() < MIN_DOTS:
        return None
    J, places = plane_map(ideal, fitted.shapes[:, :2], trusted.astype(np.float64))
    ratio = fitted.radius_px / np.sqrt(np.abs(np.linalg.det(J)))
    usual = float(np.median(ratio[trusted]))
    ratio = np.where(trusted & (np.abs(ratio / usual - 1.0) > ODD), ratio, usual)  # one may mark the origin
    A = np.linalg.inv(J * ratio[:, None, None])
    M = np.einsum("nki,nkj->nij", A, A)
    blur = float(np.clip(np.median(fitted.shapes[trusted, 5]), _MIN_BLUR_PX, None))
    return np.column_stack([places, M[:, 0, 0], M[:, 0, 1], M[:, 1, 1], np.full(len(M), blur)])


def plane_map(
    ideal: Float[np.ndarray, "n 2"], places: Float[np.ndarray, "n 2"], weights: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2 2"], Float[np.ndarray, "n 2"]]:
    """Return the map's Jacobians at the dots, px per grid unit, and where it puts them."""
    shape = grid_shape(grid_basis(ideal, places, weights), places, weights)
    return np.stack([shape.along_x, shape.along_y], axis=2), shape.points_px
