"""Measure dots at full resolution: the images of their centres, with covariances.

Each dot is fitted by `ellipse_solver`. The centre of a dot's image is not the image of its centre: perspective and
lens shift it, by a pixel for large dots near the edge of a tilted board. The shift depends only on the map from the
target plane to the image, not on focal length or pose, and the dots themselves determine that map
(`core.targets.subpixel`). So it is corrected here, once, for every estimator: the dot's outline is mapped to the
image, the ellipse that fits it as the pixels' does is found, and its centre is compared with the image of the dot's
centre.

References: J. Heikkilä, O. Silvén, "A four-step camera calibration procedure with implicit image correction", CVPR
1997, section 3.2 (the shift under perspective), doi:10.1109/CVPR.1997.609468.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.errors import DegenerateGeometry
from core.targets.circles.blobs import Dots
from core.targets.circles.ellipse_solver import fit_each
from core.targets.circles.lens_map import LensMap, fit_lens_map
from core.targets.lattice import Level
from core.targets.subpixel import grid_basis, grid_shape, levels_between

ODD = 0.25  # by how much, of the others' radius, a dot is larger or smaller that is not one of them
MIN_DOTS = 8
_SMALL_PX = 8.0
_FIRST_PRIOR_SIGMAS = (0.7, 0.7)  # of shape and blur, see `ellipse_solver.fit_dot`
_LATER_PRIOR_SIGMAS = (0.1, 0.2)
_ROUND_TRIP = 24  # places on a dot's outline
_MIN_LEFT = 0.25  # of what repeats itself: with less left by blur it is not determined
_OUTLINE = 8  # places on half of a dot's outline
_DERIVATIVE_STEP = 1e-4  # grid units: for a difference that stands for a derivative
_CORRECTIONS = 4
_SETTLED_PX = 5e-4
_MAX_STEPS = 12
_TOLERANCE = 0.2  # of the uncertainty: the next step would be a tenth of that
_START_BLUR_PX, _MIN_BLUR_PX = 1.5, 0.25
_ASTRAY = 6.0
_STRANGE = 0.1  # by how much a radius differs from the others'
_MAX_DISPLACEMENT = 0.2  # of a dot's radius: what is farther from where the others have it is not it


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


def perspective_corrected_centres(
    ideal: Float[np.ndarray, "n 2"], fitted: FittedDots, image_middle_px: Float[np.ndarray, "2"]
) -> tuple[
    Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]
]:
    """Return the images of the dots' centres, the dots' radii on the print (pitches), how far (px) the centres are off
    the map they make, and which dots agree with it.

    The map is a lens's (`lens_map`) and, for what that leaves over, a homography with a polynomial. A dot's outline is
    put through the former as it is, and through the latter's series to second order about its centre: terms of third
    order are odd, and move no centre. At the grid's ends a polynomial that has to stand for a lens has second
    derivatives of its own.
    """
    count = len(ideal)
    angle = np.arange(_OUTLINE) * (np.pi / _OUTLINE)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    squares = np.stack([0.5 * ring[:, 0] ** 2, ring[:, 0] * ring[:, 1], 0.5 * ring[:, 1] ** 2])
    measured, trusted = fitted.shapes[:, :2], fitted.trusted
    # the second place of each dot, a little along x, shows how the slope along y changes on the way there
    places = np.concatenate([ideal, ideal + np.array([_DERIVATIVE_STEP, 0.0])])
    weights = np.concatenate([trusted.astype(np.float64), np.zeros(count)])
    shift = np.zeros((count, 2))
    lens: LensMap | None = None
    for _ in range(_CORRECTIONS):
        centres = measured - shift
        weights[:count] = trusted
        lens = fit_lens_map(ideal[trusted], centres[trusted], image_middle_px, lens)
        bend, bend_slopes = np.zeros((count, 2)), np.zeros((count, 2, 2))
        if lens:
            bend, bend_slopes = lens.bend(ideal), lens.bend_slopes(ideal)
        straight = centres - bend
        twice = np.concatenate([straight, straight])
        shape = grid_shape(grid_basis(places, twice, weights), twice, weights)
        drawn = shape.points_px[:count] + bend
        J = np.stack([shape.along_x[:count], shape.along_y[:count]], axis=2) + bend_slopes
        mixed = (shape.along_y[count:] - shape.along_y[:count]) / _DERIVATIVE_STEP
        second = np.stack([shape.bend_x[:count], mixed, shape.bend_y[:count]], axis=1)
        off = np.hypot(*(centres - drawn).T)
        usual = 1.4826 * float(np.median(off[trusted])) if trusted.any() else 0.0
        trusted = trusted & (off <= _ASTRAY * max(usual, 0.01))
        radius = fitted.radius_px / np.sqrt(np.abs(J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]))
        departure = np.tensordot(second * (radius**2)[:, None, None], squares, axes=(1, 0)).transpose(0, 2, 1)
        if lens:
            departure += _bent_outlines(lens, ideal, radius[:, None, None] * ring) - bend[:, None]
        renewed = _ellipse_centres(departure, J * radius[:, None, None], ring)
        moved = float(np.max(np.abs(renewed - shift)))
        shift = renewed
        if moved < _SETTLED_PX:
            break
    return measured - shift, radius, off, _confirmed(ideal, measured - shift, fitted, radius, trusted)


def _bent_outlines(
    lens: LensMap, ideal: Float[np.ndarray, "n 2"], around: Float[np.ndarray, "n k 2"]
) -> Float[np.ndarray, "n k 2"]:
    """Return the middle of how far a lens displaces opposite places of outlines."""
    places = np.stack([ideal[:, None] + around, ideal[:, None] - around])
    return np.asarray(lens.bend(places.reshape(-1, 2)).reshape(places.shape).mean(axis=0))


def _confirmed(
    ideal: Float[np.ndarray, "n 2"],
    centres: Float[np.ndarray, "n 2"],
    fitted: FittedDots,
    radius: Float[np.ndarray, " n"],
    trusted: Bool[np.ndarray, " n"],
) -> Bool[np.ndarray, " n"]:
    """Return which dots stand where the others have them.

    A dot at the end of a line draws the map to itself, so that it seems in place wherever it is. It is asked about
    where its radius (grid units) is not the others': what is half a dot, or half a blot, is not as large as they.
    """
    if trusted.sum() <= MIN_DOTS:
        return trusted
    confirmed = trusted.copy()
    strange = np.abs(radius / np.median(radius[trusted]) - 1.0)
    strange[~trusted] = 0.0
    for n in np.argsort(-strange, kind="stable")[: np.count_nonzero(strange > _STRANGE)]:
        others = confirmed.astype(np.float64)
        others[n] = 0.0
        if np.count_nonzero(others) < MIN_DOTS:
            break
        try:
            drawn = plane_map(ideal, centres, others)[1]
        except DegenerateGeometry:  # all others lie on a line, which does not predict this one
            continue
        off = np.hypot(*(centres - drawn).T)
        usual = 1.4826 * float(np.median(off[others > 0.0]))
        confirmed[n] = off[n] <= max(_ASTRAY * usual, _MAX_DISPLACEMENT * float(fitted.radius_px[n]))
    return confirmed


def _ellipse_centres(
    departure: Float[np.ndarray, "n k 2"], A: Float[np.ndarray, "n 2 2"], ring: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, "n 2"]:
    """Return how far the centres of the ellipses that fit outlines lie from the images of the dots' centres.

    `departure` is that of the outlines from the ellipses A n, the same at opposite places. One Gauss-Newton step
    from these: distances along the edge's normal, weighted by the length of edge each place stands for, since pixels
    all along it determine the ellipse equally. At opposite places an ellipse's change of shape is the same and its
    normals are opposite, so the shape does not mix in, and half of the ring serves for the whole.
    """
    tangent = np.stack([-ring[:, 1], ring[:, 0]], axis=1) @ A.transpose(0, 2, 1)
    u, v = tangent[..., 1], -tangent[..., 0]  # the normal, as long as the edge there
    length = np.hypot(u, v)
    value = (departure[..., 0] * u + departure[..., 1] * v) / length
    uu, uv, vv = (np.sum(product / length, axis=1) for product in (u * u, u * v, v * v))
    along_u, along_v = (np.sum(value * part, axis=1) for part in (u, v))
    determinant = uu * vv - uv * uv
    return np.stack([vv * along_u - uv * along_v, uu * along_v - uv * along_u], axis=1) / determinant[:, None]
