"""Which grid point each dot of a lattice is: the turns in which the lattice is the target, and the one to take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from core.errors import TargetMirrored
from core.targets.circles.blobs import Dots
from core.targets.circles.centres import ODD, FittedDots
from core.targets.circles.lattice import DotLattice
from core.targets.circles.partial_view import along_grid_lines, candidate_orientations
from core.targets.grid_index import cells_of, is_staggered, lines
from core.targets.lattice import Level
from core.targets.specification import TargetSpec

MIN_SEEN_SHARE = 0.5
"""Of the target's dots."""
_MIN_LINE_SHARE = 0.5
_SLENDER = 1.25  # a larger dot is as round as the others; what a blot makes of one is not
MIN_FILL = 0.98
"""Of `Dots.fill`."""


@dataclass(frozen=True, slots=True)
class BoardMatch:
    """Dots of the level, and the column and row each stands for."""

    dots: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    ideal: Float[np.ndarray, "n 2"]
    """In the target plane, pitches."""


def board_matches(lattice: DotLattice, target: TargetSpec) -> list[BoardMatch]:
    """Return the ways (of four turns) in which the lattice's places are the target's, and no others."""
    found = []
    places = along_grid_lines(lattice, target)
    for _ in range(4):
        are_sites = not is_staggered(target) or places[0].sum() % 2 == 0
        if are_sites and tuple(places.max(axis=0) + 1) == lines(target):
            column, row = cells_of(target, places)
            if is_whole(row * target.columns + column, target):
                ideal = target.points_target(column, row)[:, :2] / target.pitch_mm
                found.append(BoardMatch(lattice.dots, column, row, ideal))
        places = np.stack([places[:, 1].max() - places[:, 1], places[:, 0]], axis=1)
    return found


def is_mirrored(lattice: DotLattice, target: TargetSpec) -> bool:
    """Return whether the dots are the target's seen in a mirror; a rectangle's look the same there."""
    return target.kind != "circles" and bool(
        board_matches(DotLattice(lattice.dots, lattice.places[:, ::-1]), target)
    )


def partial_matches(
    image: Shaped[np.ndarray, "h w"], level: Level, dots: Dots, lattice: DotLattice, target: TargetSpec
) -> list[BoardMatch]:
    """Return the turns in which a lattice may be a part of the target.

    Its size does not distinguish it from a grille's.
    """
    height, width = image.shape
    if np.median(dots.fill[lattice.dots]) < MIN_FILL:
        return []
    turns = candidate_orientations(
        lattice, level.to_full(dots.centres[lattice.dots]), (height, width), target
    )
    return [
        BoardMatch(lattice.dots, column, row, target.points_target(column, row)[:, :2] / target.pitch_mm)
        for column, row in turns
    ]


def is_whole(index: Int[np.ndarray, " n"], target: TargetSpec) -> bool:
    """Return whether enough dots were found, on the outermost lines as well."""
    known = np.zeros((target.rows, target.columns), dtype=np.bool_)
    known.ravel()[index] = True
    outer = (known[0], known[-1], known[:, 0], known[:, -1])
    return bool(known.mean() >= MIN_SEEN_SHARE and all(line.mean() >= _MIN_LINE_SHARE for line in outer))


def oriented(
    matches: list[BoardMatch], largest: int | None, fitted: FittedDots, target: TargetSpec, *, is_part: bool
) -> tuple[BoardMatch, bool]:
    """Return the right one of several orders, by a larger dot at the origin, or else by the x axis's direction; and
    whether it is determined.

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

    def rightward(match: BoardMatch) -> float:
        A = np.column_stack([match.ideal, np.ones(len(match.ideal))])
        u, v = np.linalg.lstsq(A, fitted.shapes[:, :2], rcond=None)[0][0]
        return float(u / np.hypot(u, v))

    return max(matches, key=rightward), False


def slenderness(J: Float[np.ndarray, "n 2 2"], fitted: FittedDots) -> Float[np.ndarray, " n"]:
    """Return how many times as long as wide the dots are on the print, by the map's Jacobians: round ones once."""
    a, b, c = fitted.shapes[:, 2:5].T
    M = np.stack([np.stack([a, b], axis=1), np.stack([b, c], axis=1)], axis=1)
    squares = np.linalg.eigvalsh(J.transpose(0, 2, 1) @ M @ J)
    return np.asarray(np.sqrt(squares[:, 1] / np.maximum(squares[:, 0], 1e-12)))


def larger_dot(
    radius: Float[np.ndarray, " n"], slender: Float[np.ndarray, " n"], seen: Bool[np.ndarray, " n"]
) -> int | None:
    """Return which of the dots seen is larger than all others on the print, if one is. Those that are slender are
    ignored, unless motion makes most of the dots so: a blot next to a dot makes it larger, too."""
    if not seen.any():
        return None
    is_round = seen & (slender < max(_SLENDER, float(np.median(slender[seen]))))
    if not is_round.any():
        return None
    ratio = np.where(is_round, radius, 0.0) / np.median(radius[seen])
    largest = int(np.argmax(ratio))
    if ratio[largest] < 1.0 + ODD or np.delete(ratio, largest).max() > 1.0 + 0.5 * (ratio[largest] - 1.0):
        return None
    return largest
