"""Find an AprilGrid: its tags label the corners, and the refiner measures them.

The lines along the tags' sides make a lattice of corners, tag, gap, tag, gap, that is found as a chessboard's is
(`core.targets.lattice`); the codes in its dark cells determine where on the grid a lattice lies (`tag_lattice`),
and several lattices are merged to one grid (`assembly`). Every corner of a tag that was read, and so
has its label from that tag itself, is then measured at full resolution like any corner of four squares (`subpixel`),
by the pixels along its edges up to half-way to the next corner, that is half the gap, and no deeper than the border.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16

from core.errors import TargetNotFound
from core.targets.aprilgrid.assembly import MIN_TAGS, TagGrid, assemble
from core.targets.aprilgrid.layout import BORDER_CELLS, TAG_CELLS, AprilGridLayout, aprilgrid_layout
from core.targets.aprilgrid.tag_lattice import TagLattice, read_lattice
from core.targets.candidates import patch_corners
from core.targets.lattice import find_saddles, levels, link
from core.targets.specification import GridPoints, TargetSpec
from core.targets.subpixel import (
    grid_basis,
    grid_shape,
    is_well_distributed,
    neighbour_inliers,
    refine_corners,
)
from core.targets.surveyed_points import measured_points

MIN_CORNERS = 8
_MAX_PATCHES = 40  # of a level, the largest
_ASTRAY, _MIN_REST_PX = 8.0, 0.02
_MAPS = 4
_MISSING_REASON = (
    "corners are missing: they are out of view, their tag was not read, or the image does not show them as corners "
    "of squares."
)
_SIDE_OFFSET = 0.06  # of an edge's length: within a tag's border, and within the gap, at any tilt


def detect_aprilgrid(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec
) -> GridPoints:
    """Find the corners of an AprilGrid's tags; see `core.targets.detection.detect`."""
    layout = aprilgrid_layout(target)
    image = np.require(image, requirements=["C", "W", "A"])
    found = _search(image, layout)
    column, row, points = found.grid_points(image.shape)
    found.check_tag_edge(image.shape)
    plain = min(layout.gap_mm, BORDER_CELLS / TAG_CELLS * layout.tag_mm)
    places = target.points_target(column, row)[:, :2] / layout.gap_mm
    refined = refine_corners(
        image, column, row, points, origin_is_black=True, places=places, plain=plain / layout.gap_mm
    )
    trusted = neighbour_inliers(places, refined.points_px, refined.standard_uncertainty_px, refined.trusted)
    trusted = _are_smooth(places, refined.points_px, trusted)
    count = int(trusted.sum())
    if count < MIN_CORNERS or not is_well_distributed(places[trusted]):
        raise TargetNotFound(
            f"{len(found.tags)} of the AprilGrid's {len(layout.tag_places)} tags were read, but {count} of its "
            f"{target.size} corners can be measured: too few.",
            "Show the grid sharp and larger: gaps and borders of tags 5 px wide and more; free of reflections.",
        )
    return measured_points(image, target, column, row, refined, trusted, _MISSING_REASON)


def _are_smooth(
    places: Float[np.ndarray, "n 2"], points_px: Float[np.ndarray, "n 2"], trusted: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Return which corners are where a smooth map through the trusted ones has them: an obstacle's edge in front of a
    tag may make another corner near its own."""
    agreeing = trusted
    for _ in range(_MAPS):
        if np.count_nonzero(agreeing) < MIN_CORNERS or not is_well_distributed(places[agreeing]):
            return agreeing
        weights = agreeing.astype(np.float64)
        shape = grid_shape(grid_basis(places, points_px, weights), points_px, weights)
        rest = np.hypot(*(points_px - shape.points_px).T)
        kept = trusted & (rest < _ASTRAY * max(float(np.median(rest[agreeing])), _MIN_REST_PX))
        if np.array_equal(kept, agreeing):
            break
        agreeing = kept
    return agreeing


def _search(image: np.ndarray, layout: AprilGridLayout) -> TagGrid:
    """Return the grid, from the level of the image pyramid that shows most of its tags.

    Raises TargetNotFound where none shows two, TargetMismatch and TargetMirrored where something else was seen.
    """
    best: TagGrid | None = None
    for level in levels(image):
        saddles = find_saddles(level)
        patches = link(saddles, _SIDE_OFFSET)
        parts: list[TagLattice] = []
        for points, place in patch_corners(level, saddles, patches, _MAX_PATCHES):
            part = read_lattice(image, layout, place, points)
            if part is not None:
                parts.append(part)
        found = assemble(parts, image, layout)
        if best is None or len(found.tags) > len(best.tags):
            best = found
        if best.is_all_in_view(image.shape):
            break
    read = 0 if best is None else len(best.tags)
    if best is None or read < MIN_TAGS:
        raise _not_found(read)
    if not best.is_verified:
        raise TargetNotFound(
            f"{read} tags of the AprilGrid were read, but all in one row: which they are of a grid of "
            f"{layout.target.columns} columns they do not prove.",
            "Bring more of the grid into view: tags of two rows at least.",
        )
    return best


def _not_found(read: int) -> TargetNotFound:
    return TargetNotFound(
        "Only one tag of the AprilGrid was found." if read else "No tag of the AprilGrid was found.",
        "Show the grid sharp, evenly lit and with tags of 25 px and more. It must be Kalibr's sheet: tags of the "
        "family 36h11 with a border of two cells, and black squares in the gaps' crossings.",
    )
