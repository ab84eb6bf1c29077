"""Finding an AprilGrid: its tags say which corners are where, the refiner says exactly where.

The lines along the tags' sides make a lattice of corners, tag, gap, tag, gap, that is found as a chessboard's is
(`saddles`, `linking`); what is printed in its dark cells tells where on the grid a lattice lies (`aprilgrid_reading`).
What is in front of the grid may cut it in several lattices: they are one grid where the plane through the nearest tags
of one is that of the other. Every grid point within a tag of one that was read is then measured at full resolution
like any corner of four squares (`refinement`), by the pixels along its edges up to half-way to the next corner, that
is half the gap: beyond that and deeper than a tag's border is nothing of the corner's own.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8, UInt16

from core.errors import Advisory, DetectionError, TargetMirrored, TargetMismatch, TargetNotFound
from core.targets.aprilgrid_layout import BORDER_CELLS, TAG_CELLS, AprilGridLayout, aprilgrid_layout
from core.targets.aprilgrid_reading import LatticePart, read_lattice
from core.targets.linking import link
from core.targets.pyramid import levels
from core.targets.refinement import refine_corners
from core.targets.saddles import find_saddles
from core.targets.specification import GridPoints, TargetSpec

Tags = dict[int, Float[np.ndarray, "4 2"]]

LEAST_TAGS, LEAST_CORNERS = 2, 8
_LEAST_PATCH = 4  # corners: one closed cell
_MOST_PATCHES = 40  # of a level, the largest
_BESIDE = 0.1  # of an edge's length: within a tag's border, and within the gap, at any tilt
_MOST_CONTRADICTING = 0.1  # of the tags that agree: a sticker, but no other sheet
_FITS = 0.3  # of a tag's side: how far a tag may be from where its neighbours predict it
_NEAREST = 4  # tags that place a grid point
_REACH = 1  # tags, from one that was read to those whose corners are looked for


def detect_aprilgrid(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec
) -> GridPoints:
    """Find the corners of an AprilGrid's tags; see `core.targets.detect.detect`."""
    layout = aprilgrid_layout(target)
    image = np.require(image, requirements=["C", "W", "A"])
    found = _search(image, layout)
    column, row, points = _place_grid_points(found, layout, image.shape)
    plain = min(layout.gap_mm, BORDER_CELLS / TAG_CELLS * layout.tag_mm)
    refined = refine_corners(
        image,
        column,
        row,
        points,
        origin_is_black=True,
        places=target.points_target(column, row)[:, :2] / layout.gap_mm,
        plain=plain / layout.gap_mm,
    )
    trusted = refined.trusted
    count = int(trusted.sum())
    if count < LEAST_CORNERS:
        raise TargetNotFound(
            f"{len(found.tags)} of the AprilGrid's {len(layout.tag_places)} tags were read, but {count} of its "
            f"{target.size} corners can be measured: too few.",
            "Show the grid sharp and larger: gaps and borders of tags 5 px wide and more; free of reflections.",
        )
    return GridPoints(
        target=target,
        image_width_px=image.shape[1],
        image_height_px=image.shape[0],
        column=column[trusted],
        row=row[trusted],
        points_px=np.ascontiguousarray(refined.points_px[trusted]),
        standard_uncertainty_px=refined.standard_uncertainty_px[trusted],
        warnings=(_left_out(target.size - count, target.size),) if count < target.size else (),
    )


class _Found:
    """Tags that make one grid, and the corners of the lattices they were read in."""

    def __init__(self) -> None:
        self.tags: Tags = {}
        self.corners: dict[tuple[int, int], Float[np.ndarray, "2"]] = {}

    def add(self, part: LatticePart) -> None:
        for tag, corners in part.tags.items():
            self.tags.setdefault(tag, corners)
        for (column, row), point in zip(part.grid.tolist(), part.points_px, strict=True):
            self.corners.setdefault((column, row), point)


def _search(image: np.ndarray, layout: AprilGridLayout) -> _Found:
    """Return the grid, from the level of the picture that shows most tags of it.

    Raises TargetNotFound where none shows two, TargetMismatch and TargetMirrored where something else was seen.
    """
    best, failure = _Found(), None
    for level in levels(image):
        saddles = find_saddles(level)
        patches = link(saddles, _BESIDE)
        parts: list[LatticePart] = []
        for number in range(min(len(patches.sizes), _MOST_PATCHES)):
            if patches.sizes[number] < _LEAST_PATCH:
                break
            members = np.flatnonzero(patches.patch == number)
            part = read_lattice(image, layout, patches.place[members], level.to_full(saddles.points[members]))
            if part is not None:
                parts.append(part)
        try:
            found = _together(parts, layout)
        except DetectionError as reason:
            failure = reason
            continue
        if len(found.tags) > len(best.tags):
            best = found
        if _is_all_in_view(best, layout, image.shape):
            break
    if len(best.tags) >= LEAST_TAGS:
        return best
    raise failure or _not_found(len(best.tags))


def _together(parts: list[LatticePart], layout: AprilGridLayout) -> _Found:
    """Return the grid that the lattices are parts of.

    Raises TargetMismatch where they are parts of another one or of several, TargetMirrored of a mirrored one.
    """
    found = _Found()
    for part in sorted(parts, key=lambda p: -len(p.tags)):
        agreeing = len(part.tags)
        if part.contradicting > max(1.0, _MOST_CONTRADICTING * agreeing) and part.contradicting >= LEAST_TAGS:
            raise TargetMismatch(
                f"AprilTags are in view, but {part.contradicting} of {agreeing + part.contradicting} are not where a "
                f"grid of {layout.target.columns} x {layout.target.rows} has them.",
                "Check the target's columns and rows, which count tags, and that the sheet is laid out as Kalibr's: "
                "ids from 0 at the lower left, row by row upward.",
            )
        if agreeing == 0:
            continue
        if found.tags and not _fits(part.tags, found.tags, layout):
            if agreeing >= LEAST_TAGS:
                raise TargetMismatch(
                    f"{agreeing} tags of the AprilGrid are in view beside others that belong to it.",
                    "Cover other sheets with the same tags, and mirrors.",
                )
            continue
        found.add(part)
    if not found.tags and any(part.is_mirrored for part in parts):
        raise TargetMirrored("The AprilGrid's tags are in view, but mirrored.")
    return found


def _fits(tags: Tags, others: Tags, layout: AprilGridLayout) -> bool:
    """Tell whether the tags lie in the others' plane where these predict them."""
    known = np.array(sorted(others))
    for tag, corners in tags.items():
        apart = np.abs(layout.tag_places[known] - layout.tag_places[tag]).max(axis=1)
        nearest = known[np.argsort(apart, kind="stable")[:_NEAREST]]
        H = _plane_through(nearest.tolist(), others, layout)
        if H is None:
            return False
        off = _mapped(H, layout.tag_corners(tag)[:, :2]).mean(axis=0) - corners.mean(axis=0)
        side = float(np.linalg.norm(corners - np.roll(corners, -1, axis=0), axis=1).min())
        # of tags far away the lens's distortion leaves more
        if not float(np.linalg.norm(off)) < _FITS * side * max(1.0, float(apart.min())):
            return False
    return True


def _is_all_in_view(found: _Found, layout: AprilGridLayout, shape: tuple[int, ...]) -> bool:
    """Tell whether every tag of the grid that can be whole in the picture was read."""
    if len(found.tags) < LEAST_TAGS:
        return False
    if len(found.tags) == len(layout.tag_places):
        return True
    H = _plane_through(sorted(found.tags), found.tags, layout)
    if H is None:
        return False
    missing = [tag for tag in range(len(layout.tag_places)) if tag not in found.tags]
    corners = _mapped(H, np.concatenate([layout.tag_corners(tag)[:, :2] for tag in missing]))
    inside = np.all((corners > 0.0) & (corners < [shape[1] - 1.0, shape[0] - 1.0]), axis=1)
    return not bool(inside.reshape(-1, 4).all(axis=1).any())


def _place_grid_points(
    found: _Found, layout: AprilGridLayout, shape: tuple[int, ...]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Return column, row and place (px) of the grid points in the picture whose tag, or one beside it, was read.

    What the lattice does not have is placed by the plane through the nearest tags.
    """
    target = layout.target
    numbers = np.array(sorted(found.tags))
    read_places = layout.tag_places[numbers]
    columns, rows, points = [], [], []
    for i, j in layout.tag_places.tolist():
        apart = np.abs(read_places - [i, j])
        if apart.max(axis=1).min() > _REACH:
            continue
        at = [(2 * i + a, 2 * j + b) for b in range(2) for a in range(2)]
        if not all(place in found.corners for place in at):
            nearest = numbers[np.argsort((apart**2).sum(axis=1), kind="stable")[:_NEAREST]]
            H = _plane_through(nearest.tolist(), found.tags, layout)
            if H is None:
                continue
            column, row = np.array(at).T
            predicted = _mapped(H, target.points_target(column, row)[:, :2])
        for k, place in enumerate(at):
            u, v = found.corners[place] if place in found.corners else predicted[k]
            if 0.0 <= u <= shape[1] - 1.0 and 0.0 <= v <= shape[0] - 1.0:
                columns.append(place[0])
                rows.append(place[1])
                points.append((u, v))
    order = np.lexsort((columns, rows))
    return np.array(columns)[order], np.array(rows)[order], np.array(points, np.float64)[order]


def _plane_through(
    numbers: list[int], tags: Tags, layout: AprilGridLayout
) -> Float[np.ndarray, "3 3"] | None:
    """Return the homography from the target's plane (mm) to pixels by these tags' corners."""
    corners = np.concatenate([layout.tag_corners(number)[:, :2] for number in numbers])
    H, _ = cv2.findHomography(corners, np.concatenate([tags[number] for number in numbers]))
    return None if H is None or not np.all(np.isfinite(H)) else np.asarray(H, np.float64)


def _mapped(H: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Return the points' pixels; far outside of any picture where the plane ends before them."""
    ahead = points @ H[:, :2].T + H[:, 2]
    scale = np.where(ahead[:, 2:] > 1e-9, ahead[:, 2:], 1e-9)
    return np.asarray(ahead[:, :2] / scale)


def _not_found(read: int) -> TargetNotFound:
    return TargetNotFound(
        "Only one tag of the AprilGrid was found." if read else "No tag of the AprilGrid was found.",
        "Show the grid sharp, evenly lit and with tags of 25 px and more. It must be Kalibr's sheet: tags of the "
        "family 36h11 with a border of two cells, and black squares in the gaps' crossings.",
    )


def _left_out(count: int, size: int) -> Advisory:
    return Advisory(
        code="corners_left_out",
        detail=f"{count} of {size} corners were left out: they are out of view, no tag near them was read, or the "
        "picture does not show them as corners of squares.",
        advice="Look at the overlay: reflections, dirt or something in front of the grid are the usual causes.",
    )
