"""Sub-pixel refinement of chessboard corners at full resolution, and what doubt is left.

Maximum likelihood on the picture's own pixels: each corner's model is that of `core.targets.corner_kernel`, with the
edges' directions and bends from all corners together (`core.targets.grid_map`). One step on every third line near the
corner, or some more where the blur is far from the usual, brings them from a detector's tenths of a px to some
hundredths and tells the blur; those that turn out to be px off come near by wide templates first. One step on all
pixels up to half-way to the next corners does the rest. No pixel serves two corners, so their errors are independent
of each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt16

from core.targets import corner_kernel as kernel
from core.targets.grey_levels import largest_level
from core.targets.grid_map import GridBasis, GridShape, grid_basis, grid_shape, grid_slopes
from core.targets.quantiles import median

_COARSE_SIGMAS_PX = (2.5, 1.5, 1.2)
"""Of the templates of the first steps: wide ones pull from further away."""
_COARSE_REACH_PX = 7.0
_MIDDLE_REACH_PX = 18.0
_SIGMA_RANGE = (0.3, 8.0)
_SETTLED_PX = 0.15
_NEAR_START_PX = 0.4
_SETTLED_BLUR, _NEARLY_SETTLED_BLUR = 0.1, 0.25  # of its logarithm; the next step leaves about the square
_MOST_MIDDLE_STEPS, _MOST_FINAL_STEPS = 4, 3
_CONVERGED_PX = 0.06
_LEAST_REACH = 1.7  # in σ, as are the spacings
_LEAST_SPACING, _LEAST_SPACING_AT_BORDER = 3.5, 4.5  # beyond the border the pattern goes on otherwise
_LONGEST_STEP = 1.5  # in σ
_BLUR_VARIES = 2.0  # over the board
_ASTRAY = 6.0
_OWN_PLACE = 0.4  # of the spacing: half-way a neighbour's begins
_OWN_PLACE_IN_PRINT = 0.2  # the same where something is printed in the squares, which has corners of its own
_LEAST_CONTRAST = 0.15  # of the median
_LEAST_ARM, _ARM_SIGMAS = 0.5, 4.0  # of the corner's contrast, across each of its four arms; beyond noise
_LARGEST_VARIANCE = 4.0  # of the residuals, times the median
_SMALL_RESIDUAL = 0.01  # of half the contrast: without noise the model itself shows
_SHARPEST_PX = 0.26
"""Below the 1/√12 of a pixel's area edges are not averaged over it: the picture is thresholded, or was resampled by the
nearest pixel, and steps stand where its lines do not."""
_SHIFT_BY_SLOPE = 0.85
"""A level rising by g per px along an edge moves it by .85 g r σ / c, r its reach and c half the contrast: the mean of
D g s over that of D², D the bell that moving the edge adds, of one sign before the corner and the other after it."""
_CUT = 0.98  # of the camera's largest level: white that high is cut off in part
_POOLED = 50.0
_ROUNDING = 1.0 / np.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class Refined:
    """Corners refined.

    `standard_uncertainty_px` holds for u and v alike; `trusted` is False where the picture contradicts the
    corner, which then has its start as its place and an infinite uncertainty. `blur_px` is the lens's Gaussian
    blur at the corner, the pixel's own area not counted; `contrast` white less black in the picture's levels.
    """

    points_px: Float[np.ndarray, "n 2"]
    standard_uncertainty_px: Float[np.ndarray, " n"]
    trusted: Bool[np.ndarray, " n"]
    blur_px: Float[np.ndarray, " n"]
    contrast: Float[np.ndarray, " n"]


def refine_corners(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"],
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    points_px: Float[np.ndarray, "n 2"],
    *,
    origin_is_black: bool,
    largest_reach: float = 0.5,
    places: Float[np.ndarray, "n 2"] | None = None,
    plain: float | None = None,
) -> Refined:
    """Refine the corners of a chessboard, or of a pattern of squares whose lines stand unevenly.

    Parameters
    ----------
    column, row
        The corners' places in the grid; any part of a grid.
    points_px
        Where they are within 2 px and a quarter of the spacing.
    origin_is_black
        Whether the square between grid points (0, 0) and (1, 1) is black.
    largest_reach
        How far from the corner pixels are used, as a share of the spacing.
    places
        Where the corners are on the print, in units of the shortest distance to a neighbour, the spacing: (column, row)
        by default.
    plain
        How far from its edges the squares are plain, in spacings. By default they are all through, and of one size.

    Raises
    ------
    InvalidArgument
        Fewer than four corners, or all on a line.
    """
    image = np.ascontiguousarray(image)
    ideal = np.asarray(np.stack([column, row], axis=1) if places is None else places, np.float64)
    count = len(ideal)
    good = np.all(np.isfinite(points_px), axis=1)
    start = np.where(good[:, None], points_px, 0.0)
    states = np.zeros((count, kernel.STATE))
    steps = np.full((count, kernel.STEP), np.nan)
    sign = np.where((column + row) % 2 == 0, -1.0, 1.0) * (1.0 if origin_is_black else -1.0)
    states[:, kernel.SIGN] = sign
    states[:, [kernel.REACH_1, kernel.REACH_2]] = np.inf
    states[:, [kernel.Q_U, kernel.Q_V]] = start
    basis = grid_basis(ideal, start, good.astype(np.float64))
    shape, _ = _fit(basis, states, good)
    states[:, [kernel.SIGMA_1, kernel.SIGMA_2]] = _COARSE_SIGMAS_PX[-1]
    _step(image, states, shape, _MIDDLE_REACH_PX, largest_reach, good, steps, stride=3)
    far = good & ~(_length(steps) < _NEAR_START_PX)
    if far.any():
        states[far, kernel.Q_U], states[far, kernel.Q_V] = start[far].T
        unsettled = far
        for sigma in _COARSE_SIGMAS_PX:
            states[np.ix_(far, [kernel.SIGMA_1, kernel.SIGMA_2])] = sigma
            _step(
                image,
                states,
                shape,
                _COARSE_REACH_PX,
                largest_reach,
                unsettled,
                steps,
                stride=3,
                is_coarse=True,
            )
            unsettled = far & ~(_length(steps) < _SETTLED_PX)
        shape, _ = _fit(basis, states, good)
    if far.any() or not _blur_is_settled(steps, _NEARLY_SETTLED_BLUR):
        for _ in range(_MOST_MIDDLE_STEPS):
            _step(image, states, shape, _MIDDLE_REACH_PX, largest_reach, good, steps, stride=2)
            if _blur_is_settled(steps, _SETTLED_BLUR):
                break
    shape, steady = _fit(basis, states, good)
    slope_doubts = _set_light(basis, ideal, column, row, shape, states, steps, steady, largest_level(image))
    unsettled = good
    for _ in range(_MOST_FINAL_STEPS):
        _step(image, states, shape, np.inf, largest_reach, unsettled, steps, stride=1)
        unsettled = good & (_length(steps) > _CONVERGED_PX)
        if not _blur_is_settled(steps, _SETTLED_BLUR):
            unsettled = good
        if not unsettled.any():
            break
    beside = _follow_map(basis, states, steps, good)
    x, y = ideal.T
    at_border = (x == x.min()) | (x == x.max()) | (y == y.min()) | (y == y.max())
    if plain is None:
        least_spacing, own_place = np.where(at_border, _LEAST_SPACING_AT_BORDER, _LEAST_SPACING), _OWN_PLACE
    else:
        least_spacing, own_place = np.full(count, _LEAST_SPACING_AT_BORDER / plain), _OWN_PLACE_IN_PRINT
    return _conclude(states, steps, points_px, good & (beside < own_place), least_spacing, slope_doubts)


def _length(steps: Float[np.ndarray, "n step"]) -> Float[np.ndarray, " n"]:
    """Return how far the corners moved, px; NaN where they did not."""
    return np.hypot(steps[:, kernel.STEP_U], steps[:, kernel.STEP_V])


def _blur_is_settled(steps: Float[np.ndarray, "n step"], limit: float) -> bool:
    """Tell whether a step changed the board's blur by less than so much of its logarithm."""
    wider = np.abs(steps[:, [kernel.WIDER_1, kernel.WIDER_2]])
    known = wider[np.isfinite(wider)]
    return known.size == 0 or median(known) < limit


def _fit(
    basis: GridBasis, states: Float[np.ndarray, "n state"], good: Bool[np.ndarray, " n"]
) -> tuple[GridShape, Bool[np.ndarray, " n"]]:
    """Fit the grid's map to where the corners are now, and return which corners are where it has them.

    Corners too near the picture's border for their edges to tell anything do not count, those far off count little.
    """
    points = states[:, [kernel.Q_U, kernel.Q_V]]
    reach = np.minimum(states[:, kernel.REACH_1], states[:, kernel.REACH_2])
    sigma = np.maximum(states[:, kernel.SIGMA_1], states[:, kernel.SIGMA_2])
    used = good & (reach >= _LEAST_REACH * sigma)
    if np.count_nonzero(used) < 4:
        used = good
    shape = grid_shape(basis, points, None if used.all() else used.astype(np.float64))
    rest, limit = _rest(points, shape, used)
    if np.max(rest[used]) > limit:
        shape = grid_shape(basis, points, used / (1.0 + (rest / (2.0 / _ASTRAY * limit)) ** 2) ** 2)
        rest, limit = _rest(points, shape, used)
    return shape, used & (rest < limit)


def _rest(
    points: Float[np.ndarray, "n 2"], shape: GridShape, used: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], float]:
    """Return how far points are from where the map has them, px, and how far is too far."""
    off = points - shape.points_px
    rest = np.hypot(off[:, 0], off[:, 1])
    return rest, _ASTRAY * max(median(rest[used]), 1e-3)


def _follow_map(
    basis: GridBasis,
    states: Float[np.ndarray, "n state"],
    steps: Float[np.ndarray, "n step"],
    good: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Move the corners by what their edges' bends, by the map through the refined corners, differ from those used.

    Return how far they are from their places by the map, in spacings.
    """
    shape, _ = _fit(basis, states, good)
    kernel.follow_edges(states, steps, shape.along_x, shape.along_y, shape.bend_x, shape.bend_y)
    spacing = np.minimum(states[:, kernel.SPACING_1], states[:, kernel.SPACING_2])
    beside = np.hypot(*(states[:, [kernel.Q_U, kernel.Q_V]] - shape.points_px).T)
    return beside / np.maximum(spacing, 1e-9)


def _step(
    image: np.ndarray,
    states: Float[np.ndarray, "n state"],
    shape: GridShape,
    reach_px: float,
    largest_reach: float,
    chosen: Bool[np.ndarray, " n"],
    steps: Float[np.ndarray, "n step"],
    *,
    stride: int,
    is_coarse: bool = False,
) -> None:
    """Set the edges by the grid's map, do one step, and move the corners (and their blur) by it."""
    height, width = image.shape
    kernel.place_edges(
        states,
        shape.along_x,
        shape.along_y,
        shape.bend_x,
        shape.bend_y,
        reach_px,
        largest_reach,
        width,
        height,
    )
    indices = np.flatnonzero(chosen)
    kernel.step_corners(image, states, indices, stride, not is_coarse, steps)
    kernel.move_corners(states, steps, indices, not is_coarse, _LONGEST_STEP, _BLUR_VARIES, *_SIGMA_RANGE)


def _set_light(
    basis: GridBasis,
    ideal: Float[np.ndarray, "n 2"],
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    shape: GridShape,
    states: Float[np.ndarray, "n state"],
    steps: Float[np.ndarray, "n step"],
    steady: Bool[np.ndarray, " n"],
    top: float,
) -> Float[np.ndarray, "n 2"]:
    """Set the slopes of level and contrast, by those of the corners themselves about each one.

    Return how doubtful the level's are along each of the two edges, per px. Where white is cut off at `top`, the
    largest level, the light's own slope, which black has yet, moves the two arms of an edge by different amounts, as a
    slope that was not given would: it is all in doubt.
    """
    contrast = steps[:, kernel.CONTRAST]
    known = steady & (contrast > 0.0)
    if known.any():
        known &= contrast > _LEAST_CONTRAST * median(contrast[known])
    slopes, doubts = grid_slopes(basis, ideal, column, row, steps[:, [kernel.LEVEL, kernel.CONTRAST]], known)
    states[:, kernel.PER_CONTRAST] = np.where(
        known, 1.0 / np.where(known, steps[:, kernel.CONTRAST], 1.0), 0.0
    )
    # by the places, to by the pixels
    x, y = shape.along_x, shape.along_y
    determinant = x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]
    determinant = np.where(np.abs(determinant) > 1e-9, determinant, np.inf)
    for k, (u, v) in enumerate(((kernel.LEVEL_U, kernel.LEVEL_V), (kernel.CONTRAST_U, kernel.CONTRAST_V))):
        by_x, by_y = slopes[:, k, 0], slopes[:, k, 1]
        states[:, u] = (by_x * y[:, 1] - by_y * x[:, 1]) / determinant
        states[:, v] = (by_y * x[:, 0] - by_x * y[:, 0]) / determinant
    of_black = np.abs(slopes[:, 0] - slopes[:, 1])
    is_cut_off = steps[:, kernel.LEVEL] + contrast > _CUT * top
    doubt = np.where(is_cut_off[:, None], np.maximum(doubts[:, 0], of_black), doubts[:, 0])
    along = np.stack([np.hypot(*y.T), np.hypot(*x.T)], axis=1)  # of the first edge, and of the second
    return np.asarray(doubt[:, ::-1] / np.maximum(along, 1e-9))


def _conclude(
    states: Float[np.ndarray, "n state"],
    steps: Float[np.ndarray, "n step"],
    start: Float[np.ndarray, "n 2"],
    good: Bool[np.ndarray, " n"],
    least_spacing: Float[np.ndarray, " n"],
    slope_doubts: Float[np.ndarray, "n 2"],
) -> Refined:
    """Judge the corners, and state their uncertainty. `least_spacing` is in σ, `slope_doubts` of the level per px."""
    points = states[:, [kernel.Q_U, kernel.Q_V]]
    sigma = np.hypot(states[:, kernel.SIGMA_1], states[:, kernel.SIGMA_2]) / np.sqrt(2.0)
    contrast = steps[:, kernel.CONTRAST]
    freedom = np.maximum(steps[:, kernel.SAMPLES] - 7.0, 1.0)
    variance = np.maximum(steps[:, kernel.SQUARES] / freedom, _ROUNDING**2)
    spacing = np.minimum(states[:, kernel.SPACING_1], states[:, kernel.SPACING_2])
    moved = np.hypot(*(points - start).T)
    reach = np.minimum(states[:, kernel.REACH_1], states[:, kernel.REACH_2])
    last = _length(steps)
    with np.errstate(invalid="ignore"):
        trusted = good & np.isfinite(last) & (contrast > 0.0) & (last < 0.3 * sigma)
        trusted &= (moved < np.maximum(2.5, 0.25 * spacing)) & (moved < _OWN_PLACE * spacing)
        trusted &= reach > _LEAST_REACH * sigma
        trusted &= spacing > least_spacing * sigma
    if trusted.any():
        trusted &= contrast > _LEAST_CONTRAST * median(contrast[trusted])
        noise = median(variance[trusted])
        relative = variance / contrast**2
        typical = median(relative[trusted])
        # in a reflex or a shadow noise and contrast change together
        excess = np.minimum(variance / noise, relative / typical)
        trusted &= (excess < _LARGEST_VARIANCE) | (relative < _SMALL_RESIDUAL**2)
        share = _POOLED / (_POOLED + freedom)
        variance = share * noise + (1.0 - share) * variance
        doubt = steps[:, kernel.WEAKEST_ARM_DOUBT] * np.sqrt(variance)
        trusted &= ~(steps[:, kernel.WEAKEST_ARM] < np.minimum(_LEAST_ARM, 1.0 - _ARM_SIGMAS * doubt))
    uneven = steps[:, kernel.UNEVEN] ** 2 / (steps[:, kernel.UNEVEN_VARIANCE] * variance)
    told = trusted & np.isfinite(uneven)
    factor = 1.0
    if np.count_nonzero(told) >= 8:
        typical = max(1.0, median(uneven[told]) / 0.455)
        trusted &= ~(uneven > 25.0 * typical)
        told &= trusted
        factor = float(np.mean(uneven[told]))
        if factor < 1.0 + 3.0 * np.sqrt(2.0 / np.count_nonzero(told)):
            factor = 1.0
    aliased_px: float | Float[np.ndarray, " n"] = 0.0
    if trusted.any():  # an edge tells its place by 1/σ, and the last step corrected σ once more
        wider = float(np.exp(median(steps[:, [kernel.WIDER_1, kernel.WIDER_2]][trusted].ravel())))
        if wider * median(sigma[trusted]) < _SHARPEST_PX:
            aliased_px = _aliasing(states)
        else:
            factor *= wider
    trace = 0.5 * (steps[:, kernel.COV_UU] + steps[:, kernel.COV_VV])
    uncertainty = np.hypot(np.sqrt(trace * variance * factor), aliased_px)
    reaches, sigmas = states[:, [kernel.REACH_1, kernel.REACH_2]], states[:, [kernel.SIGMA_1, kernel.SIGMA_2]]
    shifts = _SHIFT_BY_SLOPE * slope_doubts * reaches * sigmas / np.abs(contrast)[:, None]
    uncertainty = np.hypot(uncertainty, np.sqrt(0.5 * np.sum(shifts**2, axis=1)))
    trusted &= np.isfinite(uncertainty)
    return Refined(
        points_px=np.where(trusted[:, None], points, start),
        standard_uncertainty_px=np.where(trusted, uncertainty, np.inf),
        trusted=trusted,
        blur_px=np.sqrt(np.maximum(sigma**2 - 1.0 / 12.0, 0.0)),
        contrast=np.where(np.isfinite(contrast), 2.0 * contrast, 0.0),
    )


def _aliasing(states: Float[np.ndarray, "n state"]) -> Float[np.ndarray, " n"]:
    """Return the standard uncertainty (px) that corners have of steps of whole pixels along their edges.

    A line along one row of pixels may be anywhere in it; each step along its way tells where it is once more.
    """
    squares = np.zeros(len(states))  # of u and v together
    for n_u, reach in ((kernel.N1_U, kernel.REACH_1), (kernel.N2_U, kernel.REACH_2)):
        steps = 2.0 * states[:, reach] * np.abs(states[:, n_u : n_u + 2]).min(axis=1)
        squares += (_ROUNDING / (1.0 + steps)) ** 2
    return np.sqrt(0.5 * squares)
