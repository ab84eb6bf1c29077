"""Find boards of dots, `circles` and `asymmetric_circles`, and measure the images of their dots' centres.

Dots are detected (`blobs`), linked to lattices (`lattice`), and the lattice that has the target's places is taken, or
one that is a part of it with the larger dot at its origin (`partial_view`). Each dot is then fitted at full resolution,
and the image of its centre is determined from the fit (`centres`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Shaped, UInt8, UInt16

from core.errors import Advisory, OriginUnknown, TargetMirrored, TargetMismatch, TargetNotFound
from core.targets.circles.blobs import Dots, find_dots
from core.targets.circles.board_ends import cut_by_border, extends_beyond, without_stray_lines
from core.targets.circles.board_matching import (
    MIN_SEEN_SHARE,
    BoardMatch,
    board_matches,
    is_mirrored,
    is_whole,
    larger_dot,
    oriented,
    partial_matches,
    slenderness,
)
from core.targets.circles.centres import (
    MIN_DOTS,
    ODD,
    fit_dots,
    fourth_harmonic_share,
    perspective_corrected_centres,
    plane_map,
    step_variance,
)
from core.targets.circles.lattice import DotLattice, dot_lattices, merge_lattices, with_single_dots
from core.targets.circles.refusals import (
    MirroredBoard,
    SeenGrid,
    mirrored_board,
    not_found,
    outermost_hidden,
    seen_directly,
    seen_grid,
)
from core.targets.circles.saturation import in_saturated_white, saturation_bias, unstated_uncertainty
from core.targets.lattice import Level, levels
from core.targets.specification import GridPoints, TargetSpec, missing_points_warning
from core.targets.subpixel import is_well_distributed

_MIN_PART_SHARE = 0.75
_MIN_SHARE_TO_MERGE = 0.25
_MOST_DOTS = 2  # times the number of the board: with more of its surroundings it is another
_MAX_MERGED = 8  # lattices, from the largest on: rugs and grilles have hundreds
_SUFFICIENT_DOTS, _MIN_CLEAR_SHARE = 25, 0.25  # of the target's, outside of highlights
_IN_PLACE = 0.2  # of a dot's radius: a highlight moves it by less
_SQUARE = 0.05  # of `fourth_harmonic_share`: round dots have less than .02, a grille's of 8 px .13
_MIN_EXTENT = 0.25  # of the largest board's: a smaller one is ignored
_MAX_VARIANCE = 6.0  # of the residuals, times the median
_MIN_CONTRAST = 4.0  # standard deviations of the noise: fainter ones have a shape by chance
_ROUNDING = 1.0 / 12.0

_AMBIGUOUS = Advisory(
    code="board_symmetry_unresolved",
    detail="This board looks the same when turned; its x axis was taken to point to the right in the image.",
    advice="Use a board with a larger dot at its origin, asymmetric circles with an odd number of rows, or markers.",
)


def detect_circles(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec
) -> GridPoints:
    """Find the dots' centres of a board of circles; see `core.targets.detection.detect`."""
    image = np.require(image, requirements=["C", "W", "A"])
    height, width = image.shape
    seen: list[SeenGrid] = []
    mirrored: list[MirroredBoard] = []
    found: list[GridPoints] = []
    parts: list[tuple[Level, Dots, list[BoardMatch]]] = []
    failure: TargetNotFound | None = None
    most_dots = _MOST_DOTS * target.size
    for level in levels(image):
        for dots in find_dots(level):
            here: list[GridPoints] = []
            taken = np.zeros(len(dots), dtype=np.bool_)
            lattices = dot_lattices(dots)
            merged = 0
            for n, lattice in enumerate(lattices):
                if taken[lattice.dots].any():  # by one that was cut from it
                    continue
                whole = _without_stray_lines(image, level, dots, lattice, target)
                matches = board_matches(whole, target)
                share = len(lattice.dots) / target.size
                if not matches and _MIN_SHARE_TO_MERGE <= share < 1.0 and merged < _MAX_MERGED:
                    merged += 1
                    lattice = merge_lattices(lattice, lattices[n + 1 :], dots, most_dots)
                    taken[lattice.dots] = True
                    whole = _without_stray_lines(image, level, dots, lattice, target)
                    matches = board_matches(whole, target)
                    if not matches:
                        wider = with_single_dots(lattice, dots, most_dots)
                        matches = board_matches(
                            _without_stray_lines(image, level, dots, wider, target), target
                        )
                        if matches:
                            taken[matches[0].dots] = True
                points_px = level.to_full(dots.centres[whole.dots])
                if not matches:
                    if (
                        grid := seen_grid(whole, points_px, dots.fill[whole.dots], (height, width), target)
                    ) is not None:
                        seen.append(grid)
                    if is_mirrored(whole, target):
                        reason = f"The {target.columns} x {target.rows} dots in view are those of a mirrored print."
                        mirrored.append(mirrored_board(points_px, TargetMirrored(reason)))
                        continue
                    turned = partial_matches(image, level, dots, whole, target)
                    if turned:
                        parts.append((level, dots, turned))
                    continue
                try:
                    here.append(_grid_points(image, level, dots, matches, target))
                except TargetNotFound as refused:
                    failure = refused
                except TargetMirrored as refused:
                    mirrored.append(mirrored_board(points_px, refused))
            found.extend(_the_one(here, target))
            if any(len(points) == target.size for points in found):
                return seen_directly(max(found, key=len), mirrored)
    if found:
        return seen_directly(max(found, key=len), mirrored)
    if mirrored:
        raise mirrored[0].failure
    if parts:
        return _grid_points(image, *max(parts, key=lambda part: len(part[2][0].dots)), target, is_part=True)
    raise failure or not_found(seen, target)


def _without_stray_lines(
    image: Shaped[np.ndarray, "h w"], level: Level, dots: Dots, lattice: DotLattice, target: TargetSpec
) -> DotLattice:
    height, width = image.shape
    return without_stray_lines(lattice, level.to_full(dots.centres[lattice.dots]), (height, width), target)


def _the_one(found: list[GridPoints], target: TargetSpec) -> list[GridPoints]:
    """Return the board among those of one image; of several the one compared with which the others are small, as prints
    and reflections of a board are.

    Raises TargetMismatch where there are two.
    """
    extent = [float(np.ptp(points.points_px, axis=0).max()) for points in found]
    large = [points for points, px in zip(found, extent, strict=True) if px > _MIN_EXTENT * max(extent)]
    if len(large) > 1:
        raise TargetMismatch(
            f"{len(large)} grids of {target.columns} x {target.rows} dots are in view, one was asked for.",
            "Cover the others, or use boards of different sizes.",
        )
    return large


def _grid_points(
    image: Shaped[np.ndarray, "h w"],
    level: Level,
    dots: Dots,
    matches: list[BoardMatch],
    target: TargetSpec,
    *,
    is_part: bool = False,
) -> GridPoints:
    fitted = fit_dots(image, level, dots, matches[0].dots, matches[0].ideal)
    enough = _MIN_PART_SHARE * len(matches[0].dots) if is_part else MIN_SEEN_SHARE * target.size
    if fitted.trusted.sum() < max(MIN_DOTS, enough):
        raise _too_poor(target, int(fitted.trusted.sum()))
    if fourth_harmonic_share(image, fitted) > _SQUARE:
        raise TargetNotFound(
            f"A grid of {target.columns} x {target.rows} patches is in view, but they are square, not round.",
            "Show the board of dots, and keep gratings and tiles of as many columns and rows out of view.",
        )
    variance, contrast = fitted.variance, fitted.contrast
    noise = np.maximum(variance, _ROUNDING)
    uncertainty = np.sqrt(noise * 0.5 * np.trace(fitted.covariance, axis1=1, axis2=2) + step_variance(fitted))
    clipped = in_saturated_white(image, fitted, are_dark=dots.are_dark)
    moved = saturation_bias(image, fitted, clipped, are_dark=dots.are_dark)
    clear = fitted.trusted & (moved <= uncertainty)
    # Before the dots' common map is fitted: what is half hidden would pull it.
    usual = float(np.median(variance[clear])) if clear.any() else 0.0
    similar = (variance <= _MAX_VARIANCE * max(usual, 1.0)) & (contrast >= _MIN_CONTRAST * np.sqrt(noise))
    clear &= similar
    _require_clear(clear, matches[0], target)
    clear &= ~cut_by_border(matches[0].ideal, replace(fitted, trusted=clear), image.shape)
    uncertainty = np.hypot(uncertainty, moved)
    middle = 0.5 * (np.array(image.shape[::-1]) - 1.0)
    centres, radius, off, clear = perspective_corrected_centres(
        matches[0].ideal, replace(fitted, trusted=clear), uncertainty, middle
    )
    _require_clear(clear, matches[0], target)
    uncertainty = np.hypot(
        uncertainty,
        unstated_uncertainty(replace(fitted, trusted=clear), radius, off, clipped, uncertainty),
    )
    J, drawn = plane_map(matches[0].ideal, centres, clear.astype(np.float64))
    in_place = np.hypot(*(centres - drawn).T) <= _IN_PLACE * fitted.radius_px
    # Dots in a highlight, half hidden, or cut by the image border serve for labels, but not for places.
    trusted = clear | (fitted.trusted & similar & in_place)
    usual_contrast, usual_radius = (
        float(np.median(values[trusted])) if trusted.any() else 0.0 for values in (contrast, radius)
    )
    larger = larger_dot(radius, slenderness(J, fitted), trusted)
    match, is_resolved = oriented(matches, larger, fitted, target, is_part=is_part)
    warnings: tuple[Advisory, ...] = () if is_resolved else (_AMBIGUOUS,)
    odd = np.abs(radius - usual_radius) > ODD * usual_radius  # cut, half hidden, or no dots of the board
    if larger is not None and match.column[larger] == 0 and match.row[larger] == 0:
        odd[larger] = False
    trusted &= ~odd
    index = match.row * target.columns + match.column
    if trusted.sum() < enough:
        raise _too_poor(target, int(trusted.sum()))
    if not (is_part or is_whole(index[trusted], target)):
        raise outermost_hidden(target)
    if is_part and not is_resolved:
        raise OriginUnknown(
            f"Part of a grid of {target.columns} x {target.rows} dots is in view, and no larger dot at its origin "
            "determines which part."
        )
    dark = usual_contrast if dots.are_dark else -usual_contrast
    if not is_part and extends_beyond(
        image, target, match.column[trusted], match.row[trusted], centres[trusted], dark
    ):
        raise TargetNotFound(
            f"A grid of {target.columns} x {target.rows} dots is in view, but it goes on beyond them.",
            "Count the board's dots, and take away what lies across it; keep larger grids, grilles and gratings out of "
            "view.",
        )
    trusted &= clear
    count = int(trusted.sum())
    order = np.flatnonzero(trusted)
    order = order[np.lexsort((match.column[order], match.row[order]))]
    if count < target.size:
        where = "out of view, " if is_part else ""
        reason = (
            f"dots are missing: they are {where}hidden, cut by the image border, not clear enough, or in saturated "
            "white."
        )
        warnings = (*warnings, missing_points_warning(target.size - count, target.size, reason))
    return GridPoints(
        target=target,
        image_width_px=image.shape[1],
        image_height_px=image.shape[0],
        column=match.column[order],
        row=match.row[order],
        points_px=np.ascontiguousarray(centres[order]),
        standard_uncertainty_px=uncertainty[order],
        warnings=warnings,
        labelling="absolute" if is_resolved else "up_to_symmetry",
    )


def _require_clear(clear: Bool[np.ndarray, " n"], match: BoardMatch, target: TargetSpec) -> None:
    """Raise TargetNotFound unless the clear dots suffice to measure the board by them."""
    enough = max(MIN_DOTS, min(_SUFFICIENT_DOTS, _MIN_CLEAR_SHARE * target.size))
    if clear.sum() < enough or not is_well_distributed(match.ideal[clear]):
        raise _too_poor(target, int(clear.sum()))


def _too_poor(target: TargetSpec, count: int) -> TargetNotFound:
    return TargetNotFound(
        f"A grid of {target.columns} x {target.rows} dots is in view, but {target.size - count} of its dots are "
        "too poor to measure.",
        "Light the board evenly, focus, keep it in view and free of reflections; dots of 10 px and more serve best.",
    )
