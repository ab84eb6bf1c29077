"""Finding boards of dots, `circles` and `asymmetric_circles`, and the pictures of their dots' centres.

Dots are found (`dots`), linked to lattices (`dot_lattice`), and the lattice that has the target's places is taken, or
one that may be a part of it (`partial_dots`). Each dot is then fitted at full resolution, and its centre's picture told
from that (`dot_refinement`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8, UInt16

from core.errors import Advisory, TargetMirrored, TargetMismatch, TargetNotFound
from core.targets.dot_ends import goes_on
from core.targets.dot_highlights import centre_shifts
from core.targets.dot_lattice import DotLattice, dot_lattices, joined
from core.targets.dot_refinement import (
    LEAST_DOTS,
    ODD,
    FittedDots,
    corrected_centres,
    fit_dots,
    plane_map,
    squareness,
)
from core.targets.dot_sites import cells_of, is_staggered, lines
from core.targets.dots import Dots, find_dots
from core.targets.partial_dots import along_lines, part_turns
from core.targets.pyramid import Level, levels
from core.targets.specification import GridPoints, Origin, TargetSpec, points_left_out

_ENOUGH_SEEN = 0.5
_ENOUGH_OF_PART = 0.75
_ENOUGH_TO_JOIN = 0.25
_ENOUGH_OF_LINE = 0.5
_ENOUGH_DOTS, _ENOUGH_CLEAR = 25, 0.25  # of the target's, outside of highlights
_IN_PLACE = 0.2  # of a dot's radius: a highlight moves it by less
_ROUND = 0.98  # of `Dots.fill`
_SLENDER = 1.25  # a larger dot is as round as the others; what a blot makes of one is not
_SQUARE = 0.05  # of `squareness`: round dots have less than .02, a grille's of 8 px .13
_LEAST_EXTENT = 0.25  # of the largest board's: a smaller one does not count beside it
_LARGEST_VARIANCE = 6.0  # of the residuals, times the median
_LEAST_CONTRAST = 0.25  # of the median
_ROUNDING = 1.0 / 12.0

_AMBIGUOUS = Advisory(
    code="orientation_ambiguous",
    detail="This board looks the same when turned; its x axis was taken to point to the right in the image.",
    advice="Use a board with a larger dot at its origin, asymmetric circles with an odd number of rows, or markers.",
)


@dataclass(frozen=True, slots=True)
class _Match:
    """Dots of the level, and the column and row each stands for."""

    dots: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    ideal: Float[np.ndarray, "n 2"]
    """In the target plane, pitches."""


def detect_circles(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec
) -> GridPoints:
    """Find the dots' centres of a board of circles; see `core.targets.detect.detect`."""
    image = np.require(image, requirements=["C", "W", "A"])
    seen: list[tuple[int, int]] = []
    found: list[GridPoints] = []
    parts: list[tuple[Level, Dots, list[_Match]]] = []
    failure: TargetNotFound | None = None
    for level in levels(image):
        for dots in find_dots(level):
            here: list[GridPoints] = []
            taken = np.zeros(len(dots), dtype=np.bool_)
            lattices = dot_lattices(dots)
            for n, lattice in enumerate(lattices):
                if taken[lattice.dots].any():  # by one that was cut from it
                    continue
                extent = lattice.places.max(axis=0) - lattice.places.min(axis=0) + 1
                if len(lattice.dots) >= _ENOUGH_OF_PART * extent[0] * extent[1]:
                    seen.append((int(extent.max()), int(extent.min())))
                matches = _matches(lattice, target)
                if not matches and len(lattice.dots) >= _ENOUGH_TO_JOIN * target.size:
                    lattice = joined(lattice, lattices[n + 1 :], dots)
                    taken[lattice.dots] = True
                    matches = _matches(lattice, target)
                if not matches:
                    if _is_mirrored(lattice, target):
                        raise TargetMirrored(
                            f"The {target.columns} x {target.rows} dots in view are those of a mirrored print."
                        )
                    turned = _part_matches(image, level, dots, lattice, target)
                    if turned:
                        parts.append((level, dots, turned))
                    continue
                try:
                    here.append(_grid_points(image, level, dots, matches, target))
                except TargetNotFound as reason:
                    failure = reason
            found.extend(_the_one(here, target))
            if any(len(points) == target.size for points in found):
                return max(found, key=len)
    if found:
        return max(found, key=len)
    if parts:
        return _grid_points(image, *max(parts, key=lambda part: len(part[2][0].dots)), target, is_part=True)
    raise failure or _not_found(seen, target)


def _the_one(found: list[GridPoints], target: TargetSpec) -> list[GridPoints]:
    """Return the board among those of one picture; of several the one beside which the others are small, as pictures
    and reflections of a board are.

    Raises TargetMismatch where there are two.
    """
    extent = [float(np.ptp(points.points_px, axis=0).max()) for points in found]
    large = [points for points, px in zip(found, extent, strict=True) if px > _LEAST_EXTENT * max(extent)]
    if len(large) > 1:
        raise TargetMismatch(
            f"{len(large)} grids of {target.columns} x {target.rows} dots are in view, one was asked for.",
            "Cover the others, or use boards of different sizes.",
        )
    return large


def _not_found(seen: list[tuple[int, int]], target: TargetSpec) -> TargetNotFound | TargetMismatch:
    """Return what to say of a picture without the board: what was seen in its place."""
    asked = f"{target.columns} x {target.rows}"
    if not seen or target.kind != "circles":
        return TargetNotFound(f"No grid of {asked} dots was found.")
    long, short = max(seen, key=lambda size: size[0] * size[1])
    if long > max(target.columns, target.rows) or short > min(target.columns, target.rows):
        return TargetMismatch(f"A grid of {long} x {short} dots is in view, {asked} was asked for.")
    return TargetNotFound(f"Only {long} x {short} dots of a grid are wholly in view, {asked} were asked for.")


def _matches(lattice: DotLattice, target: TargetSpec) -> list[_Match]:
    """Return the ways (of four turns) in which the lattice's places are the target's, and no others."""
    found = []
    places = along_lines(lattice, target)
    for _ in range(4):
        are_sites = not is_staggered(target) or places[0].sum() % 2 == 0
        if are_sites and tuple(places.max(axis=0) + 1) == lines(target):
            column, row = cells_of(target, places)
            if _is_whole(row * target.columns + column, target):
                ideal = target.points_target(column, row)[:, :2] / target.pitch_mm
                found.append(_Match(lattice.dots, column, row, ideal))
        places = np.stack([places[:, 1].max() - places[:, 1], places[:, 0]], axis=1)
    return found


def _is_mirrored(lattice: DotLattice, target: TargetSpec) -> bool:
    """Tell whether the dots are the target's seen in a mirror; a rectangle's look the same there."""
    return target.kind != "circles" and bool(
        _matches(DotLattice(lattice.dots, lattice.places[:, ::-1]), target)
    )


def _part_matches(
    image: Shaped[np.ndarray, "h w"], level: Level, dots: Dots, lattice: DotLattice, target: TargetSpec
) -> list[_Match]:
    """Return the turns in which a lattice may be a part of the target; its size does not tell it from a grille's."""
    height, width = image.shape
    if np.median(dots.fill[lattice.dots]) < _ROUND:
        return []
    turns = part_turns(lattice, level.to_full(dots.centres[lattice.dots]), (height, width), target)
    return [
        _Match(lattice.dots, column, row, target.points_target(column, row)[:, :2] / target.pitch_mm)
        for column, row in turns
    ]


def _is_whole(index: Int[np.ndarray, " n"], target: TargetSpec) -> bool:
    """Tell whether enough dots were found, on the outermost lines as well."""
    known = np.zeros((target.rows, target.columns), dtype=np.bool_)
    known.ravel()[index] = True
    outer = (known[0], known[-1], known[:, 0], known[:, -1])
    return bool(known.mean() >= _ENOUGH_SEEN and all(line.mean() >= _ENOUGH_OF_LINE for line in outer))


def _grid_points(
    image: Shaped[np.ndarray, "h w"],
    level: Level,
    dots: Dots,
    matches: list[_Match],
    target: TargetSpec,
    *,
    is_part: bool = False,
) -> GridPoints:
    fitted = fit_dots(image, level, dots, matches[0].dots, matches[0].ideal)
    enough = _ENOUGH_OF_PART * len(matches[0].dots) if is_part else _ENOUGH_SEEN * target.size
    if fitted.trusted.sum() < max(LEAST_DOTS, enough):
        raise _too_poor(target, int(fitted.trusted.sum()))
    if squareness(image, fitted) > _SQUARE:
        raise TargetNotFound(
            f"A grid of {target.columns} x {target.rows} patches is in view, but they are square, not round.",
            "Show the board of dots, and keep gratings and tiles of as many columns and rows out of the picture.",
        )
    variance, contrast = fitted.variance, fitted.contrast
    noise = np.maximum(variance, _ROUNDING)
    uncertainty = np.sqrt(noise * 0.5 * np.trace(fitted.covariance, axis1=1, axis2=2))
    moved = centre_shifts(image, fitted, are_dark=dots.are_dark)
    clear = fitted.trusted & (moved <= uncertainty)
    if clear.sum() < max(LEAST_DOTS, min(_ENOUGH_DOTS, _ENOUGH_CLEAR * target.size)) or not _is_spread(
        matches[0].ideal[clear]
    ):
        raise _too_poor(target, int(clear.sum()))
    uncertainty = np.hypot(uncertainty, moved)
    centres, radius, trusted = corrected_centres(matches[0].ideal, replace(fitted, trusted=clear))
    J, drawn = plane_map(matches[0].ideal, centres, trusted.astype(np.float64))
    in_place = np.hypot(*(centres - drawn).T) <= _IN_PLACE * fitted.radius_px
    trusted |= fitted.trusted & ~clear & in_place  # what stands in a highlight tells names, but no places
    usual, usual_contrast, usual_radius = (
        float(np.median(values[trusted])) if trusted.any() else 0.0 for values in (variance, contrast, radius)
    )
    trusted &= (variance <= _LARGEST_VARIANCE * max(usual, 1.0)) & (
        contrast >= _LEAST_CONTRAST * usual_contrast
    )
    larger = _larger_dot(radius, trusted & (_slenderness(J, fitted) < _SLENDER))
    match, is_told = _oriented(matches, larger, fitted, target, is_part=is_part)
    warnings: tuple[Advisory, ...] = () if is_told or is_part else (_AMBIGUOUS,)
    origin: Origin = "known" if is_told else "unknown" if is_part else "turned"
    odd = np.abs(radius - usual_radius) > ODD * usual_radius  # cut, half hidden, or no dots of the board
    if larger is not None and match.column[larger] == 0 and match.row[larger] == 0:
        odd[larger] = False
    trusted &= ~odd
    index = match.row * target.columns + match.column
    if trusted.sum() < enough or not (is_part or _is_whole(index[trusted], target)):
        raise _too_poor(target, int(trusted.sum()))
    dark = usual_contrast if dots.are_dark else -usual_contrast
    if not is_part and goes_on(
        image, target, match.column[trusted], match.row[trusted], centres[trusted], dark
    ):
        raise TargetNotFound(
            f"A grid of {target.columns} x {target.rows} dots is in view, but it goes on beyond them.",
            "Count the board's dots; keep larger grids, grilles and gratings out of the picture.",
        )
    trusted &= clear
    count = int(trusted.sum())
    order = np.flatnonzero(trusted)
    order = order[np.lexsort((match.column[order], match.row[order]))]
    if count < target.size:
        reason = "dots were left out: they are hidden, not clear enough, or in saturated white."
        if is_part:
            reason = (
                "dots were left out: they are out of view, hidden, not clear enough, or in saturated white."
            )
        warnings = (*warnings, points_left_out(target.size - count, target.size, reason))
    return GridPoints(
        target=target,
        image_width_px=image.shape[1],
        image_height_px=image.shape[0],
        column=match.column[order],
        row=match.row[order],
        points_px=np.ascontiguousarray(centres[order]),
        standard_uncertainty_px=uncertainty[order],
        warnings=warnings,
        origin=origin,
    )


def _is_spread(ideal: Float[np.ndarray, "n 2"]) -> bool:
    """Tell whether places are those of a plane's points, not of a line's."""
    return bool(np.linalg.svd(ideal - ideal.mean(axis=0), compute_uv=False)[1] > 0.5)


def _too_poor(target: TargetSpec, count: int) -> TargetNotFound:
    return TargetNotFound(
        f"A grid of {target.columns} x {target.rows} dots is in view, but {target.size - count} of its dots are "
        "too poor to measure.",
        "Light the board evenly, focus, and keep it free of reflections; dots of 10 px and more serve best.",
    )


def _oriented(
    matches: list[_Match], largest: int | None, fitted: FittedDots, target: TargetSpec, *, is_part: bool
) -> tuple[_Match, bool]:
    """Return the right one of several orders, by a larger dot at the origin, or else by the x axis's direction; and
    whether it is told.

    Raises TargetMirrored where the larger dot is at a corner of the board that no turn makes the origin.
    """
    if len(matches) == 1 and not is_part:
        return matches[0], True
    if largest is not None:
        for match in matches:
            if match.column[largest] == 0 and match.row[largest] == 0:
                return match, True
        column, row = matches[0].column[largest], matches[0].row[largest]
        if not is_part and column in (0, target.columns - 1) and row in (0, target.rows - 1):
            raise TargetMirrored(
                "The larger dot is at a corner where only a mirrored print of the board has its origin.",
                "Print the target without mirroring, and switch image mirroring off; or, if the print is right, "
                "exchange the target's columns and rows.",
            )

    def rightward(match: _Match) -> float:
        A = np.column_stack([match.ideal, np.ones(len(match.ideal))])
        u, v = np.linalg.lstsq(A, fitted.shapes[:, :2], rcond=None)[0][0]
        return float(u / np.hypot(u, v))

    return max(matches, key=rightward), False


def _slenderness(J: Float[np.ndarray, "n 2 2"], fitted: FittedDots) -> Float[np.ndarray, " n"]:
    """Return how many times as long as wide the dots are on the print, by the map's Jacobians: round ones once."""
    a, b, c = fitted.shapes[:, 2:5].T
    M = np.stack([np.stack([a, b], axis=1), np.stack([b, c], axis=1)], axis=1)
    squares = np.linalg.eigvalsh(J.transpose(0, 2, 1) @ M @ J)
    return np.asarray(np.sqrt(squares[:, 1] / np.maximum(squares[:, 0], 1e-12)))


def _larger_dot(radius: Float[np.ndarray, " n"], trusted: Bool[np.ndarray, " n"]) -> int | None:
    """Return which dot is larger than all others on the print, if one is; none that the picture does not show as a dot:
    a blot beside one makes it larger, too."""
    if not trusted.any():
        return None
    ratio = np.where(trusted, radius, 0.0) / np.median(radius[trusted])
    largest = int(np.argmax(ratio))
    if ratio[largest] < 1.0 + ODD or np.delete(ratio, largest).max() > 1.0 + 0.5 * (ratio[largest] - 1.0):
        return None
    return largest
