"""The images of dots' centres, by what the dots of a board say of each other.

The centre of a dot's image is not the image of its centre: perspective and lens shift it, by a pixel for large dots
near the edge of a tilted board. The shift depends only on the map from the target plane to the image, not on focal
length or pose, and the dots themselves determine that map (`core.targets.subpixel`). So it is corrected here, once, for
every estimator: the dot's outline is mapped to the image, the ellipse that fits it as the pixels' does is found, and
its centre is compared with the image of the dot's centre.

What covers a dot along an edge leaves a smaller ellipse, fitted as well as the others and off by half of what is
covered. Its outline shows it: all dots of a print are equally large circles, so the map says what each looks like.

References: J. Heikkilä, O. Silvén, "A four-step camera calibration procedure with implicit image correction", CVPR
1997, section 3.2 (the shift under perspective), doi:10.1109/CVPR.1997.609468.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from core.targets.circles.centres.ellipse_fit import ODD, FittedDots
from core.targets.circles.centres.lens_map import LensMap, fit_lens_map
from core.targets.subpixel import grid_basis, grid_shape, is_well_distributed, neighbour_inliers

_OUTLINE = 8  # places on half of a dot's outline
_CORRECTIONS = 12  # at most: three, where all dots agree
_SETTLED_PX = 5e-4
_ASTRAY, _MISSHAPEN = 6.0, 4.0
"""Times what is usual, of places and of outlines: of the latter's three unknowns, nine standard deviations."""
_LEAST_OFF_PX = 0.01


def perspective_corrected_centres(
    ideal: Float[np.ndarray, "n 2"],
    fitted: FittedDots,
    uncertainty_px: Float[np.ndarray, " n"],
    image_middle_px: Float[np.ndarray, "2"],
) -> tuple[
    Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]
]:
    """Return the images of the dots' centres, the dots' radii on the print (pitches), how far (px) the centres are off
    the map they make, and which of the trusted dots agree with it in place and outline.

    The map is a lens's (`lens_map`) and, for what that leaves over, a homography with a polynomial. A dot's outline is
    put through the former as it is, and through the latter's series to second order about its centre: terms of third
    order are odd, and move no centre. At the grid's ends a polynomial that has to stand for a lens has second
    derivatives of its own. `uncertainty_px` is that of the fitted centres.
    """
    count = len(ideal)
    angle = np.arange(_OUTLINE) * (np.pi / _OUTLINE)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    squares = np.stack([0.5 * ring[:, 0] ** 2, ring[:, 0] * ring[:, 1], 0.5 * ring[:, 1] ** 2])
    measured = fitted.shapes[:, :2]
    # Before a map of all is fitted: what is half hidden would pull it.
    trusted = neighbour_inliers(ideal, measured, uncertainty_px, fitted.trusted, most_uncertain=np.inf)
    shift = np.zeros((count, 2))
    lens: LensMap | None = None
    radius, off = np.zeros(count), np.zeros(count)
    for corrected in range(_CORRECTIONS):
        if not is_well_distributed(ideal[trusted]):
            break  # they determine no map
        centres = measured - shift
        weights = trusted.astype(np.float64)
        lens = fit_lens_map(ideal[trusted], centres[trusted], image_middle_px, lens)
        bend = lens.bend(ideal)
        straight = centres - bend
        shape = grid_shape(grid_basis(ideal, straight, weights), straight, weights)
        drawn = shape.points_px + bend
        J = np.stack([shape.along_x, shape.along_y], axis=2) + lens.bend_slopes(ideal)
        second = np.stack([shape.bend_x, shape.bend_xy, shape.bend_y], axis=1)
        off = np.hypot(*(centres - drawn).T)
        radius = fitted.radius_px / np.sqrt(np.abs(J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]))
        before = trusted
        if corrected:  # till then larger dots are farther off than others
            apart = _outlines_off(fitted.shapes, J, radius, before)
            usual = _usual(off, before, _LEAST_OFF_PX)
            trusted = trusted & (off <= _ASTRAY * usual)
            # A map that misses places by so much knows outlines no better.
            trusted &= apart <= _MISSHAPEN * _usual(apart, before, np.maximum(2.0 * uncertainty_px, usual))
        departure = np.tensordot(second * (radius**2)[:, None, None], squares, axes=(1, 0)).transpose(0, 2, 1)
        departure += _bent_outlines(lens, ideal, radius[:, None, None] * ring) - bend[:, None]
        renewed = _ellipse_centres(departure, J * radius[:, None, None], ring)
        moved = float(np.max(np.abs(renewed - shift)[before])) if before.any() else 0.0
        shift = renewed
        if corrected and moved < _SETTLED_PX and np.array_equal(before, trusted):
            break
    return measured - shift, radius, off, trusted


def _usual(
    off_px: Float[np.ndarray, " n"],
    trusted: Bool[np.ndarray, " n"],
    least_px: float | Float[np.ndarray, " n"],
) -> float | Float[np.ndarray, " n"]:
    """Return how far off the trusted ones usually are, `least_px` at least."""
    return np.maximum(1.4826 * float(np.median(off_px[trusted])) if trusted.any() else 0.0, least_px)


def _outlines_off(
    shapes: Float[np.ndarray, "n 6"],
    J: Float[np.ndarray, "n 2 2"],
    radius: Float[np.ndarray, " n"],
    trusted: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Return how far (px, root mean square) the dots' outlines are from those that the map J gives circles of their
    usual radius, less what is common to all: light makes all edges wander. Of a larger dot, which may mark the origin,
    roundness alone counts.
    """
    if not trusted.any():
        return np.zeros(len(shapes))
    usual = float(np.median(radius[trusted]))
    larger = radius > (1.0 + ODD) * usual
    expected = np.where(larger, radius, usual)[:, None, None] * J
    M = np.stack([shapes[:, 2:4], shapes[:, 3:5]], axis=1)
    apart = _roots(np.linalg.inv(M)) - _roots(expected @ expected.transpose(0, 2, 1))
    apart -= np.median(apart[trusted], axis=0)
    apart[larger] -= 0.5 * np.trace(apart[larger], axis1=1, axis2=2)[:, None, None] * np.eye(2)
    return np.asarray(np.sqrt(0.5 * np.sum(apart**2, axis=(1, 2))))


def _roots(C: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n 2 2"]:
    """Return the symmetric roots of matrices: an ellipse's half axes (px) in their directions."""
    s = np.sqrt(np.maximum(np.linalg.det(C), 0.0))[:, None, None]
    return np.asarray((C + s * np.eye(2)) / np.sqrt(np.trace(C, axis1=1, axis2=2)[:, None, None] + 2.0 * s))


def _bent_outlines(
    lens: LensMap, ideal: Float[np.ndarray, "n 2"], around: Float[np.ndarray, "n k 2"]
) -> Float[np.ndarray, "n k 2"]:
    """Return the middle of how far a lens displaces opposite places of outlines."""
    places = np.stack([ideal[:, None] + around, ideal[:, None] - around])
    return np.asarray(lens.bend(places.reshape(-1, 2)).reshape(places.shape).mean(axis=0))


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
