"""Refine chessboard corners to sub-pixel places at full resolution, with their uncertainty.

Maximum likelihood on the image's own pixels: each corner's model is that of
`core.targets.subpixel.corner_model`, with the edges' directions and bends from all corners together
(`core.targets.subpixel.smooth_map`). One step on every third line near the corner, or some more where the
blur is far from the usual, brings them from a detector's tenths of a px to some hundredths and determines the
blur; those that turn out to be px off come near by wide templates first. One step on all pixels up to
half-way to the next corners does the rest. No pixel serves two corners, so their errors are independent of
each other.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt16

from core.numerics import median
from core.targets.subpixel import corner_model as model
from core.targets.subpixel.corner_acceptance import (
    MAX_DISPLACEMENT,
    MIN_CONTRAST,
    MIN_REACH,
    RefinedCorners,
    accepted_corners,
    step_lengths,
)
from core.targets.subpixel.corner_motion import follow_edges, move_corners, place_edges
from core.targets.subpixel.corner_step import step_corners
from core.targets.subpixel.light_slopes import grid_slopes
from core.targets.subpixel.sampling import largest_level
from core.targets.subpixel.smooth_map import GridBasis, GridShape, grid_basis, grid_shape

_COARSE_SIGMAS_PX = (2.5, 1.5, 1.2)
"""Of the templates of the first steps: wide ones pull from further away."""
_COARSE_REACH_PX = 7.0
_MIDDLE_REACH_PX = 18.0
_SIGMA_RANGE = (0.3, 8.0)
_SETTLED_PX = 0.15
_NEAR_START_PX = 0.4
_SETTLED_BLUR, _NEARLY_SETTLED_BLUR = 0.1, 0.25  # of its logarithm; the next step leaves about the square
_MAX_MIDDLE_STEPS, _MAX_FINAL_STEPS = 4, 3
_CONVERGED_PX = 0.06
_MIN_SPACING, _MIN_SPACING_AT_BORDER = 3.5, 4.5  # in σ; beyond the border the pattern goes on otherwise
_LONGEST_STEP = 1.5  # in σ
_BLUR_VARIES = 2.0  # over the board
_ASTRAY = 6.0
_MAX_DISPLACEMENT_IN_PRINT = (
    0.2  # as MAX_DISPLACEMENT where something is printed in the squares, which has corners of its own
)
_LARGEST_REACH = 0.5  # how far from the corner pixels are used, as a share of the spacing
_CUT = 0.98  # of the camera's largest level: white that high is cut off in part


def refine_corners(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"],
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
    points_px: Float[np.ndarray, "n 2"],
    *,
    origin_is_black: bool,
    places: Float[np.ndarray, "n 2"] | None = None,
    plain: float | None = None,
    marker_margin: float = 0.0,
    marker_border: float = 0.0,
) -> RefinedCorners:
    """Refine the corners of a chessboard, or of a pattern of squares whose lines stand unevenly.

    Parameters
    ----------
    column, row
        The corners' places in the grid; any part of a grid.
    points_px
        Where they are within 2 px and a quarter of the spacing.
    origin_is_black
        Whether the square between grid points (0, 0) and (1, 1) is black.
    places
        Where the corners are on the print, in units of the shortest distance to a neighbour, the spacing: (column, row)
        by default.
    plain
        How far from its edges the squares are plain, in spacings. By default they are all through, and of one size.
    marker_margin, marker_border
        Of the markers in the bright squares: the width of the white around them, and of their black border, in
        spacings. By default the bright squares are plain.

    Raises
    ------
    DegenerateGeometry
        Fewer than four corners, or all on a line.
    """
    image = np.ascontiguousarray(image)
    ideal = np.asarray(np.stack([column, row], axis=1) if places is None else places, np.float64)
    count = len(ideal)
    good = np.all(np.isfinite(points_px), axis=1)
    start = np.where(good[:, None], points_px, 0.0)
    states = np.zeros((count, model.STATE))
    steps = np.full((count, model.STEP), np.nan)
    sign = np.where((column + row) % 2 == 0, -1.0, 1.0) * (1.0 if origin_is_black else -1.0)
    states[:, model.SIGN] = sign
    states[:, [model.REACH_1, model.REACH_2]] = np.inf
    states[:, model.MARGIN], states[:, model.BORDER] = marker_margin, marker_border
    states[:, [model.Q_U, model.Q_V]] = start
    basis = grid_basis(ideal, start, good.astype(np.float64))
    shape, _ = _fit(basis, states, good)
    states[:, [model.SIGMA_1, model.SIGMA_2]] = _COARSE_SIGMAS_PX[-1]
    _step(image, states, shape, _MIDDLE_REACH_PX, good, steps, stride=3)
    far = good & ~(step_lengths(steps) < _NEAR_START_PX)
    if far.any():
        states[far, model.Q_U], states[far, model.Q_V] = start[far].T
        unsettled = far
        for sigma in _COARSE_SIGMAS_PX:
            states[np.ix_(far, [model.SIGMA_1, model.SIGMA_2])] = sigma
            _step(
                image,
                states,
                shape,
                _COARSE_REACH_PX,
                unsettled,
                steps,
                stride=3,
                is_coarse=True,
            )
            unsettled = far & ~(step_lengths(steps) < _SETTLED_PX)
        shape, _ = _fit(basis, states, good)
    if far.any() or not _blur_is_settled(steps, _NEARLY_SETTLED_BLUR):
        for _ in range(_MAX_MIDDLE_STEPS):
            _step(image, states, shape, _MIDDLE_REACH_PX, good, steps, stride=2)
            if _blur_is_settled(steps, _SETTLED_BLUR):
                break
    shape, steady = _fit(basis, states, good)
    slope_sigmas = _set_light(basis, ideal, column, row, shape, states, steps, steady, largest_level(image))
    unsettled = good
    for _ in range(_MAX_FINAL_STEPS):
        _step(image, states, shape, np.inf, unsettled, steps, stride=1)
        unsettled = good & (step_lengths(steps) > _CONVERGED_PX)
        if not _blur_is_settled(steps, _SETTLED_BLUR):
            unsettled = good
        if not unsettled.any():
            break
    displacement = _follow_map(basis, states, steps, good)
    x, y = ideal.T
    at_border = (x == x.min()) | (x == x.max()) | (y == y.min()) | (y == y.max())
    if plain is None:
        least_spacing, max_displacement = (
            np.where(at_border, _MIN_SPACING_AT_BORDER, _MIN_SPACING),
            MAX_DISPLACEMENT,
        )
    else:
        least_spacing, max_displacement = (
            np.full(count, _MIN_SPACING_AT_BORDER / plain),
            _MAX_DISPLACEMENT_IN_PRINT,
        )
    return accepted_corners(
        states, steps, points_px, good & (displacement < max_displacement), least_spacing, slope_sigmas
    )


def _blur_is_settled(steps: Float[np.ndarray, "n step"], limit: float) -> bool:
    """Return whether a step changed the board's blur by less than so much of its logarithm."""
    wider = np.abs(steps[:, [model.WIDER_1, model.WIDER_2]])
    known = wider[np.isfinite(wider)]
    return known.size == 0 or median(known) < limit


def _fit(
    basis: GridBasis, states: Float[np.ndarray, "n state"], good: Bool[np.ndarray, " n"]
) -> tuple[GridShape, Bool[np.ndarray, " n"]]:
    """Fit the grid's map to where the corners are now, and return which corners are where it has them.

    Corners too near the image border for their edges to be measured do not count, those far off count little.
    """
    points = states[:, [model.Q_U, model.Q_V]]
    reach = np.minimum(states[:, model.REACH_1], states[:, model.REACH_2])
    sigma = np.maximum(states[:, model.SIGMA_1], states[:, model.SIGMA_2])
    used = good & (reach >= MIN_REACH * sigma)
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
    follow_edges(states, steps, shape.along_x, shape.along_y, shape.bend_x, shape.bend_y)
    spacing = np.minimum(states[:, model.SPACING_1], states[:, model.SPACING_2])
    displacement = np.hypot(*(states[:, [model.Q_U, model.Q_V]] - shape.points_px).T)
    return displacement / np.maximum(spacing, 1e-9)


def _step(
    image: np.ndarray,
    states: Float[np.ndarray, "n state"],
    shape: GridShape,
    reach_px: float,
    chosen: Bool[np.ndarray, " n"],
    steps: Float[np.ndarray, "n step"],
    *,
    stride: int,
    is_coarse: bool = False,
) -> None:
    """Set the edges by the grid's map, do one step, and move the corners (and their blur) by it."""
    height, width = image.shape
    place_edges(
        states,
        shape.along_x,
        shape.along_y,
        shape.bend_x,
        shape.bend_y,
        reach_px,
        _LARGEST_REACH,
        width,
        height,
    )
    indices = np.flatnonzero(chosen)
    step_corners(image, states, indices, stride, not is_coarse, steps)
    move_corners(states, steps, indices, not is_coarse, _LONGEST_STEP, _BLUR_VARIES, *_SIGMA_RANGE)


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

    Return the standard uncertainty of the level's slopes along each of the two edges, per px. Where white is cut off
    at `top`, the largest level, black still has the light's own slope, which moves the two arms of an edge by different
    amounts, as a slope that was not given would: there the whole slope counts as uncertainty.
    """
    contrast = steps[:, model.CONTRAST]
    known = steady & (contrast > 0.0)
    if known.any():
        known &= contrast > MIN_CONTRAST * median(contrast[known])
    slopes, sigmas = grid_slopes(basis, ideal, column, row, steps[:, [model.LEVEL, model.CONTRAST]], known)
    states[:, model.PER_CONTRAST] = np.where(known, 1.0 / np.where(known, steps[:, model.CONTRAST], 1.0), 0.0)
    # by the places, to by the pixels
    x, y = shape.along_x, shape.along_y
    determinant = x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]
    determinant = np.where(np.abs(determinant) > 1e-9, determinant, np.inf)
    for k, (u, v) in enumerate(((model.LEVEL_U, model.LEVEL_V), (model.CONTRAST_U, model.CONTRAST_V))):
        by_x, by_y = slopes[:, k, 0], slopes[:, k, 1]
        states[:, u] = (by_x * y[:, 1] - by_y * x[:, 1]) / determinant
        states[:, v] = (by_y * x[:, 0] - by_x * y[:, 0]) / determinant
    of_black = np.abs(slopes[:, 0] - slopes[:, 1])
    is_cut_off = steps[:, model.LEVEL] + contrast > _CUT * top
    slope_sigma = np.where(is_cut_off[:, None], np.maximum(sigmas[:, 0], of_black), sigmas[:, 0])
    along = np.stack([np.hypot(*y.T), np.hypot(*x.T)], axis=1)  # of the first edge, and of the second
    return np.asarray(slope_sigma[:, ::-1] / np.maximum(along, 1e-9))
