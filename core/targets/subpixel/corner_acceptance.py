"""Which refined corners count, and how uncertain they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.numerics import median
from core.targets.subpixel import corner_model as model

MIN_REACH = 1.7
"""Of an edge from its corner, in σ."""
MAX_DISPLACEMENT = 0.4
"""In spacings: half-way a neighbour's place begins."""
MIN_CONTRAST = 0.15
"""Of the median."""
_MIN_ARM, _ARM_SIGMAS = 0.5, 4.0  # of the corner's contrast, across each of its four arms; beyond noise
_MIN_EXPLAINED = 25.0
"""What a corner explains of its pixels' squares, in the residuals' variance. White noise behind a smooth cover lets it
explain 6, the number of unknowns besides the level, and up to 19 where a place and a blur were found that suit it.
Sharp corners 8 px apart whose contrast is four times the noise explain 30 and more; blurred ones 17, and few are
lost."""
_MAX_VARIANCE = 4.0  # of the residuals, times the median
_SMALL_RESIDUAL = 0.01  # of half the contrast: without noise the model itself shows
_MOST_SPREAD, _MISFIT = 0.1, 0.25
"""How far ink or cut-off white has spread, in spacings, and the residuals, in half the contrast: beyond both, the two
ends of an edge lie so far apart that the corner may be that of one of them."""
_SHARPEST_PX = 0.26
"""Below the 1/√12 of a pixel's area edges are not averaged over it: the image is thresholded, or was resampled by the
nearest pixel, and its steps are displaced from its lines."""
_SHIFT_BY_SLOPE = 0.85
"""A level rising by g per px along an edge moves it by .85 g r σ / c, r its reach and c half the contrast: the mean of
D g s over that of D², D the bell that moving the edge adds, of one sign before the corner and the other after it."""
_POOLED = 50.0
_ROUNDING = 1.0 / np.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class RefinedCorners:
    """Corners refined.

    `standard_uncertainty_px` is the same for u and v; `trusted` is False where the image contradicts the
    corner, which then has its start as its place and an infinite uncertainty. `blur_px` is the lens's Gaussian
    blur at the corner, the pixel's own area not counted; `contrast` white less black in the image's levels.
    """

    points_px: Float[np.ndarray, "n 2"]
    standard_uncertainty_px: Float[np.ndarray, " n"]
    trusted: Bool[np.ndarray, " n"]
    blur_px: Float[np.ndarray, " n"]
    contrast: Float[np.ndarray, " n"]


def accepted_corners(
    states: Float[np.ndarray, "n state"],
    steps: Float[np.ndarray, "n step"],
    start: Float[np.ndarray, "n 2"],
    good: Bool[np.ndarray, " n"],
    least_spacing: Float[np.ndarray, " n"],
    slope_sigmas: Float[np.ndarray, "n 2"],
) -> RefinedCorners:
    """Judge the corners, and state their uncertainty. `least_spacing` is in σ, `slope_sigmas` of the level per px."""
    points = states[:, [model.Q_U, model.Q_V]]
    sigma = np.hypot(states[:, model.SIGMA_1], states[:, model.SIGMA_2]) / np.sqrt(2.0)
    contrast = steps[:, model.CONTRAST]
    freedom = np.maximum(steps[:, model.SAMPLES] - 7.0, 1.0)
    variance = np.maximum(steps[:, model.SQUARES] / freedom, _ROUNDING**2)
    spacing = np.minimum(states[:, model.SPACING_1], states[:, model.SPACING_2])
    moved = np.hypot(*(points - start).T)
    reach = np.minimum(states[:, model.REACH_1], states[:, model.REACH_2])
    last = step_lengths(steps)
    with np.errstate(invalid="ignore"):
        trusted = good & np.isfinite(last) & (contrast > 0.0) & (last < 0.3 * sigma)
        trusted &= (moved < np.maximum(2.5, 0.25 * spacing)) & (moved < MAX_DISPLACEMENT * spacing)
        trusted &= reach > MIN_REACH * sigma
        trusted &= spacing > least_spacing * sigma
    if trusted.any():
        trusted &= contrast > MIN_CONTRAST * median(contrast[trusted])
        noise = median(variance[trusted])
        relative = variance / contrast**2
        typical = median(relative[trusted])
        # In σ, thresholded edges have spread as far as ones that lie apart.
        spread = steps[trusted, model.SPREAD] * sigma[trusted] / spacing[trusted]
        if abs(median(spread)) > _MOST_SPREAD and typical > _MISFIT**2:
            trusted[:] = False
        # in a reflex or a shadow noise and contrast change together
        excess = np.minimum(variance / noise, relative / typical)
        trusted &= (excess < _MAX_VARIANCE) | (relative < _SMALL_RESIDUAL**2)
        share = _POOLED / (_POOLED + freedom)
        variance = share * noise + (1.0 - share) * variance
        trusted &= steps[:, model.EXPLAINED] > _MIN_EXPLAINED * variance
        arm_sigma = steps[:, model.WEAKEST_ARM_SIGMA] * np.sqrt(variance)
        trusted &= ~(steps[:, model.WEAKEST_ARM] < np.minimum(_MIN_ARM, 1.0 - _ARM_SIGMAS * arm_sigma))
    uneven = steps[:, model.UNEVEN] ** 2 / (steps[:, model.UNEVEN_VARIANCE] * variance)
    assessed = trusted & np.isfinite(uneven)
    factor = 1.0
    if np.count_nonzero(assessed) >= 8:
        typical = max(1.0, median(uneven[assessed]) / 0.455)
        trusted &= ~(uneven > 25.0 * typical)
        assessed &= trusted
        factor = float(np.mean(uneven[assessed]))
        if factor < 1.0 + 3.0 * np.sqrt(2.0 / np.count_nonzero(assessed)):
            factor = 1.0
    aliased_px: float | Float[np.ndarray, " n"] = 0.0
    if trusted.any():  # an edge determines its place by 1/σ, and the last step corrected σ once more
        wider = float(np.exp(median(steps[:, [model.WIDER_1, model.WIDER_2]][trusted].ravel())))
        if wider * median(sigma[trusted]) < _SHARPEST_PX:
            aliased_px = _aliasing(states)
        else:
            factor *= wider
    trace = 0.5 * (steps[:, model.COV_UU] + steps[:, model.COV_VV])
    uncertainty = np.hypot(np.sqrt(trace * variance * factor), aliased_px)
    reaches, sigmas = states[:, [model.REACH_1, model.REACH_2]], states[:, [model.SIGMA_1, model.SIGMA_2]]
    shifts = _SHIFT_BY_SLOPE * slope_sigmas * reaches * sigmas / np.abs(contrast)[:, None]
    uncertainty = np.hypot(uncertainty, np.sqrt(0.5 * np.sum(shifts**2, axis=1)))
    trusted &= np.isfinite(uncertainty)
    return RefinedCorners(
        points_px=np.where(trusted[:, None], points, start),
        standard_uncertainty_px=np.where(trusted, uncertainty, np.inf),
        trusted=trusted,
        blur_px=np.sqrt(np.maximum(sigma**2 - 1.0 / 12.0, 0.0)),
        contrast=np.where(np.isfinite(contrast), 2.0 * contrast, 0.0),
    )


def _aliasing(states: Float[np.ndarray, "n state"]) -> Float[np.ndarray, " n"]:
    """Return the standard uncertainty (px) that corners have of steps of whole pixels along their edges.

    A line along one row of pixels may be anywhere in it; each step along its way determines its place once more.
    """
    squares = np.zeros(len(states))  # of u and v together
    for n_u, reach in ((model.N1_U, model.REACH_1), (model.N2_U, model.REACH_2)):
        steps = 2.0 * states[:, reach] * np.abs(states[:, n_u : n_u + 2]).min(axis=1)
        squares += (_ROUNDING / (1.0 + steps)) ** 2
    return np.sqrt(0.5 * squares)


def step_lengths(steps: Float[np.ndarray, "n step"]) -> Float[np.ndarray, " n"]:
    """Return how far the corners moved, px; NaN where they did not."""
    return np.hypot(steps[:, model.STEP_U], steps[:, model.STEP_V])
