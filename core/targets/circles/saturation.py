"""What dots show of the uncertainty of their centres that their edges do not: their scatter about the map they make,
and how saturated white displaces them.

Where white is cut off at the camera's largest level, the grey half-way between black and what is left of white is no
longer at the dot's edge: with d the dark grey, C the contrast the light would give, T the largest level and s the blur,

    edge moves by δ = s Φ⁻¹(q),   q = (T - d) / (2 C)

Under even light that is the same all around the dot, and no centre moves. Light that changes by g per px moves the two
sides of a dot of radius r differently, and its centre by

    s / φ(Φ⁻¹(q)) · g r / (2 C)  ≥  √(π / 2) s g r / C

C is hidden in what was cut off. The contrast that is left, in its place, makes that larger, as the greater depth of the
cut does.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float, Shaped
from scipy.spatial import cKDTree

from core.targets.circles.centres import LENS_PARAMETERS, ODD, FittedDots, outlines
from core.targets.subpixel import largest_level, levels_between

_TOP = 0.995  # of the largest level
_MIN_CLIPPED_SHARE = 0.02  # of the white pixels that determine the edge
_NEIGHBOURS = 8
_SURE = 3.0  # standard deviations
_MIN_FREE = 3  # coordinates beyond the parameters of the dots' map
_FEW = 20  # dots, of which the mean says more than the median
_MEDIAN_SCATTER = 1.44  # of the median of n squared lengths in the plane, by itself and 1/√n
_ROUNDING = 1.0 / 12.0


def in_saturated_white(
    image: Shaped[np.ndarray, "h w"], fitted: FittedDots, *, are_dark: bool
) -> Bool[np.ndarray, " n"]:
    """Return about which dots white is cut off."""
    blur = fitted.shapes[:, 5]
    side = 1.0 if are_dark else -1.0
    white = np.concatenate(
        [
            levels_between(image, *outlines(fitted.shapes, side * far))
            for far in (1.5 * blur + 0.5, 3.0 * blur + 1.0)
        ],
        axis=1,
    )
    return np.asarray((white >= _TOP * largest_level(image)).mean(axis=1) > _MIN_CLIPPED_SHARE)


def unstated_uncertainty(
    fitted: FittedDots,
    radius: Float[np.ndarray, " n"],
    off_px: Float[np.ndarray, " n"],
    clipped: Bool[np.ndarray, " n"],
    uncertainty_px: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Return what the dots themselves show that their uncertainties (px) lack.

    They scatter about the map they make, by what prints and lenses have beyond it; in saturated white by more, for the
    model of an edge does not describe one that is cut off, and what is left over depends on how the pixels lie on it.
    There the radii show by how much δ the edges moved, too; where δ changes over the board, centres move by r |∇δ|.

    Parameters
    ----------
    radius
        On the print, pitches.
    off_px
        Of the centres from the map they make.
    clipped
        About which dots white is cut off.
    """
    found = np.zeros(len(radius))
    total = int(fitted.trusted.sum())
    if 2 * total >= LENS_PARAMETERS + _MIN_FREE:
        free = 1.0 - LENS_PARAMETERS / (2.0 * total)
        in_units = np.full(len(radius), np.nan)  # of dots that were fitted; others have no uncertainty
        in_units[fitted.trusted] = (off_px[fitted.trusted] / uncertainty_px[fitted.trusted]) ** 2 / (
            2.0 * free
        )
        for kind in (clipped, ~clipped):
            some = fitted.trusted & kind
            count = int(some.sum())
            if not count:
                continue
            if count >= _FEW:  # the median of so many squares scatters by a part of itself
                ratio = float(np.median(in_units[some])) / math.log(2.0)
                by_chance = 1.0 + _SURE * _MEDIAN_SCATTER / math.sqrt(count)
            else:
                ratio = float(np.mean(in_units[some]))
                by_chance = 1.0 + _SURE / math.sqrt(count * free)
            if ratio > by_chance:
                stated = float(np.sqrt(np.mean(uncertainty_px[some] ** 2)))
                found[kind] = stated * math.sqrt(ratio - 1.0)
    return np.hypot(found, _moved_by_saturation(fitted, radius, clipped))


def _moved_by_saturation(
    fitted: FittedDots, radius: Float[np.ndarray, " n"], clipped: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return r |∇δ| of the dots in saturated white, 0 of the others."""
    known = np.flatnonzero(fitted.trusted)
    if not clipped[known].any() or len(known) <= _NEIGHBOURS:
        return np.zeros(len(radius))
    whole = fitted.trusted & ~clipped
    true_radius = np.median(radius[whole if whole.sum() >= _NEIGHBOURS else fitted.trusted])
    grown = fitted.radius_px * (1.0 - true_radius / radius)
    known = known[np.abs(grown[known]) < ODD * fitted.radius_px[known]]  # the dot at the origin may be larger
    if len(known) <= _NEIGHBOURS:
        return np.zeros(len(radius))
    centres = fitted.shapes[:, :2]
    _, near = cKDTree(centres[known]).query(centres, k=_NEIGHBOURS + 1)
    slope, _ = _slopes(centres[known[near]], grown[known[near]])
    return np.where(clipped, slope * fitted.radius_px, 0.0)


def saturation_bias(
    image: Shaped[np.ndarray, "h w"],
    fitted: FittedDots,
    clipped: Bool[np.ndarray, " n"],
    *,
    are_dark: bool,
) -> Float[np.ndarray, " n"]:
    """Return how far (px) light that is added, a lamp's reflection, may have moved the centres of the dots in white
    that it saturates; 0 for the others."""
    if not clipped.any():
        return np.zeros(len(clipped))
    blur = fitted.shapes[:, 5]
    u, v = outlines(fitted.shapes, (-1.0 if are_dark else 1.0) * (3.0 * blur + 1.0))
    dark = levels_between(image, u, v)
    within, sigma = _slopes(np.stack([u, v], axis=2), dark)
    noise = np.sqrt(np.maximum(fitted.variance, _ROUNDING))
    if are_dark:  # nearer to the centre than half-way no ring lies: that of a small dot is in its edge's blur
        within[3.0 * blur + 1.0 > 0.5 * fitted.radius_px] = 0.0
    slope = np.maximum(_slopes_between(fitted, np.median(dark, axis=1)), within - _SURE * noise * sigma)
    contrast = np.maximum(fitted.contrast, 1.0)
    return np.where(clipped, math.sqrt(0.5 * math.pi) * blur * slope * fitted.radius_px / contrast, 0.0)


def _slopes_between(fitted: FittedDots, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return how steep (per px) values are about each dot, by those nearest to it: far surer than within one dot, but
    blind to light that ends between them."""
    known = np.flatnonzero(fitted.trusted)
    if len(known) < _NEIGHBOURS:
        return np.zeros(len(values))
    centres = fitted.shapes[:, :2]
    _, near = cKDTree(centres[known]).query(centres, k=_NEIGHBOURS)
    return _slopes(centres[known[near]], values[known[near]])[0]


def _slopes(
    places: Float[np.ndarray, "n k 2"], values: Float[np.ndarray, "n k"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return the slopes of planes through values, and their standard deviations for values of variance one."""
    x, y = places - places.mean(axis=1, keepdims=True), values - values.mean(axis=1, keepdims=True)
    N = np.einsum("nki,nkj->nij", x, x)
    trace = np.trace(N, axis1=1, axis2=2)
    N += 1e-6 * trace[:, None, None] * np.eye(2)  # places on a line do not determine the slope across it
    slope = np.linalg.solve(N, np.einsum("nki,nk->ni", x, y)[..., None])[..., 0]
    return np.asarray(np.hypot(*slope.T)), np.sqrt(2.0 / trace)
