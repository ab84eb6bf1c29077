"""Finding a ChArUco board: its markers say which grid points are where, the refiner says exactly where.

The corners of its squares make a lattice as a chessboard's do, and are found in the same way, coarse to fine; the
markers are then read where the lattice has them, and place it on the board (`placement`). Parts of the board on
both sides of something in front of it are joined if they lie in one plane. Where no lattice is found the image itself
and its double are looked at, for small squares, and then OpenCV's detector looks for markers (`isolated_markers`). The
corners are refined as any chessboard's (`refinement`), by pixels along the squares' edges; the markers' edges are part
of the model where the blur brings them there.

Any part of a board serves that has enough corners for a pose, and enough markers to be distinguished from all else:
some that agree where the board is, in rows that determine its width, and next to none that contradict them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int, UInt8, UInt16

from core.errors import DetectionError, TargetMirrored, TargetMismatch, TargetNotFound
from core.targets.charuco.board_ends import extends_beyond
from core.targets.charuco.isolated_markers import (
    consistent_markers,
    detect_isolated_markers,
    outlier_markers,
    place_grid_points,
    refined_markers,
)
from core.targets.charuco.layout import CharucoLayout, charuco_layout, column_offset
from core.targets.charuco.marker_agreement import has_enough_markers, is_inconsistent
from core.targets.charuco.pieces import LatticePiece, corners_in_view, merge_pieces
from core.targets.charuco.placement import (
    PlacedLattice,
    lattices_of,
    locate_on_board,
)
from core.targets.lattice import Lattice, fine_levels, levels
from core.targets.markers import MarkerDictionary, marker_codes
from core.targets.specification import GridPoints, TargetSpec
from core.targets.subpixel import is_well_distributed, neighbour_inliers, refine_corners
from core.targets.surveyed_points import measured_points

MIN_CORNERS = 8
"""The fewest that determine a pose with its covariance; of a board with fewer than twice as many, half."""
_MIN_SHARE_IN_VIEW = (
    0.5  # of the corners that should be in view: with fewer, finer levels are looked at as well
)
_MANY_PLAIN = 200  # corners of a lattice without markers, a floor's: it is not grown again on finer levels
_BOARD_LIKE = 6  # framed squares in one lattice: a board with markers, whichever


def detect_charuco(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec
) -> GridPoints:
    """Find the inner corners of a ChArUco board; see `core.targets.detection.detect`."""
    layout = charuco_layout(target)
    codes = marker_codes(str(target.dictionary))
    image = np.require(image, requirements=["C", "W", "A"])
    seen = find_by_lattice(image, layout, codes)
    part = seen.part
    if part is not None:
        part = LatticePiece(
            part.column, part.row, part.points_px, refined_markers(image, part.markers, layout)
        )
    else:
        if seen.contradicts_layout:
            raise _not_found(seen.lattices, target)
        part = find_by_markers(image, layout, codes)
        if part is None:
            raise _not_found(seen.lattices, target)
    ends = any(lattice.ends_as_stated for lattice in seen.lattices)
    return _measured(image, part, layout, ends_as_stated=ends)


@dataclass(frozen=True, slots=True)
class Seen:
    """The lattices found, on one level after the other, and the board that they make."""

    lattices: tuple[PlacedLattice, ...]
    part: LatticePiece | None

    @property
    def contradicts_layout(self) -> bool:
        """Whether a board is in view that is another one, or mirrored."""
        return any(lattice.verdict in ("contradicted", "mirrored") for lattice in self.lattices)


def find_by_lattice(image: np.ndarray, layout: CharucoLayout, codes: MarkerDictionary) -> Seen:
    """Find the board by the lattice of its squares' corners. Raises TargetMismatch where there are two of it."""
    found: list[PlacedLattice] = []
    plain: list[Lattice] = []
    part = None
    for level in levels(image):
        for lattice in lattices_of(image, level, layout):
            found.append(locate_on_board(image, lattice, layout, codes))
            if found[-1].framed == 0 and np.count_nonzero(lattice.known) > _MANY_PLAIN:
                plain.append(lattice)
        part = merge_pieces(found, layout, codes)
        if part is not None and len(part) >= _MIN_SHARE_IN_VIEW * corners_in_view(
            part, layout.target, image.shape
        ):
            break
    if part is not None or Seen(tuple(found), part).contradicts_layout:
        return Seen(tuple(found), part)
    for level in fine_levels(image):
        found += [
            locate_on_board(image, lattice, layout, codes)
            for lattice in lattices_of(image, level, layout, is_fine=True, known=plain)
        ]
        part = merge_pieces(found, layout, codes)
        if part is not None:
            break
    return Seen(tuple(found), part)


def find_by_markers(image: np.ndarray, layout: CharucoLayout, codes: MarkerDictionary) -> LatticePiece | None:
    """Find the board by markers that OpenCV's detector finds; None where too few fit together.

    Raises TargetMismatch where markers are in view more than once, or contradict those that fit.
    """
    markers, repeated = detect_isolated_markers(image, layout)
    fitting = consistent_markers(markers, layout)
    if not fitting and repeated:
        raise TargetMismatch(
            f"{len(repeated)} of the ChArUco board's markers are in view more than once.",
            "Cover the other boards with the same markers, and mirrors.",
        )
    if not fitting or not has_enough_markers(fitting, layout, codes):
        return None
    strays = outlier_markers(markers, fitting, layout)
    if is_inconsistent(len(strays), len(fitting)):
        raise _another_board(len(fitting) + len(strays), len(fitting), layout.target)
    return LatticePiece(*place_grid_points(fitting, layout, image.shape), fitting)


def _measured(
    image: np.ndarray, part: LatticePiece, layout: CharucoLayout, *, ends_as_stated: bool
) -> GridPoints:
    """Return the refined corners of a part of the board. Raises TargetNotFound where too few can be trusted."""
    target = layout.target
    column, row = part.column, part.row
    places = np.stack([column, row], axis=1).astype(np.float64)
    if is_well_distributed(places):
        refined = refine_corners(
            image,
            column,
            row,
            part.points_px,
            origin_is_black=bool(layout.black[1, 1]),
            marker_margin=layout.margin,
            marker_border=layout.cell,
        )
        trusted = neighbour_inliers(
            places, refined.points_px, refined.standard_uncertainty_px, refined.trusted
        )
    else:
        trusted = np.zeros(len(column), dtype=np.bool_)
    count = int(trusted.sum())
    if count < min(MIN_CORNERS, 0.5 * target.size) or not is_well_distributed(places[trusted]):
        raise TargetNotFound(
            f"{len(part.markers)} of the ChArUco board's {len(layout.marker_squares)} markers were found, and "
            f"{count} of its {target.size} corners can be measured: too few.",
            "Bring more of the board into view, free of reflections and of anything in front of it.",
        )
    if not ends_as_stated and _layout_is_open(part, column[trusted], row[trusted], layout):
        raise TargetNotFound(
            f"The {len(part.markers)} markers read are as well those of the same board with legacy_layout "
            f"{str(not target.legacy_layout).lower()}, displaced by one column.",
            "Bring more of the board into view, its first or last column too: only an end determines which of the two "
            "layouts is printed. If all of it is in view, check its marker_mm: with a wrong one few markers are read.",
        )
    reason = (
        "corners are missing: they are out of view, no marker near them was read, or the image does not show them "
        "as corners of squares."
    )
    return measured_points(image, target, column, row, refined, trusted, reason, markers_px=part.markers)


def _layout_is_open(
    part: LatticePiece, column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], layout: CharucoLayout
) -> bool:
    """Return whether the board with the other `legacy_layout` explains markers and corners as well, by other labels."""
    offset = column_offset(part.markers, layout)
    return offset != 0 and not extends_beyond(
        column + offset, row, (layout.target.columns, layout.target.rows)
    )


def _not_found(lattices: tuple[PlacedLattice, ...], target: TargetSpec) -> DetectionError:
    """Return the error for an image without the board; it states what was found instead."""
    mirrored = [lattice for lattice in lattices if lattice.verdict == "mirrored"]
    if mirrored:
        count = max(lattice.agreeing for lattice in mirrored)
        return TargetMirrored(f"{count} of the ChArUco board's markers are in view, mirrored.")
    contradicted = [lattice for lattice in lattices if lattice.verdict == "contradicted"]
    if contradicted:
        most = max(contradicted, key=lambda lattice: lattice.read)
        return _another_board(most.read, most.agreeing, target)
    layout = charuco_layout(target)
    # as many as a board of this size has, about: floors and woven cloth have more
    most_printed = 2 * len(layout.marker_squares)
    small = [lattice for lattice in lattices if _BOARD_LIKE <= lattice.small_print <= most_printed]
    if small:
        square_px = max(small, key=lambda lattice: lattice.small_print).square_px
        return TargetNotFound(
            f"A board with markers is in view, but its squares are only {square_px:.0f} px wide, and the cells of its "
            f"markers {layout.cell * square_px:.1f} px: too few of them can be read.",
            "Move the camera nearer, or use a board with larger squares: 20 px and more. If they are larger in the "
            "image, check marker_mm and dictionary.",
        )
    agreeing = max((lattice.agreeing for lattice in lattices), default=0)
    if agreeing > 1:
        return TargetNotFound(
            f"{agreeing} of the ChArUco board's markers were found where they belong: too few, or all in one row.",
            "Bring more of the board into view, sharp, free of reflections and of anything in front of it; if all of "
            "it is, check its marker_mm and dictionary.",
        )
    framed = max((lattice.framed for lattice in lattices), default=0)
    if framed >= _BOARD_LIKE:
        return TargetNotFound(
            f"A board with markers is in view, but hardly any of {framed} reads as one of this board's, of "
            f"{target.dictionary}.",
            "Check its dictionary, and its marker_mm; if they are right, show it sharp and with markers of 20 px and "
            "more.",
        )
    return TargetNotFound(
        "No ChArUco board was found: no two markers of it side by side as printed.",
        "Show the board sharp, evenly lit and with markers of 20 px and more; check its dictionary, size, marker_mm "
        "and legacy_layout.",
    )


def _another_board(read: int, agreeing: int, target: TargetSpec) -> TargetMismatch:
    board = f"a ChArUco board of {target.columns} x {target.rows} inner corners"
    detail = (
        f"{read} markers of {target.dictionary} are in view, but only {agreeing} of them stand as on {board}."
        if agreeing < read
        else f"{read} markers stand as on {board}, but the one in view ends before that one does, or goes on beyond it."
    )
    return TargetMismatch(
        detail,
        "Check columns and rows, which count inner corners, and legacy_layout; keep other boards with the same "
        "dictionary out of view.",
    )
