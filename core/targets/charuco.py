"""Finding a ChArUco board: its markers say which grid points are where, the refiner says exactly where.

OpenCV's detector finds and reads the markers. One that does not fit the board together with a neighbour is none of it,
whatever it reads: what four corners of one marker predict of the next one over must be there, which lens distortion
hardly touches and a misread marker does not satisfy. Each grid point beside a marker, or one square further, is placed
by the plane through the markers nearest to it, and refined as any chessboard's corner (`refinement`), which uses the
pixels along the squares' edges only and so never sees the markers.

References: Garrido-Jurado et al. 2014 as in `core.targets.charuco_layout`.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8, UInt16

from core.errors import Advisory, TargetMismatch, TargetNotFound
from core.targets.charuco_layout import CharucoLayout, charuco_layout, marker_dictionary
from core.targets.refinement import refine_corners
from core.targets.specification import GridPoints, TargetSpec

Markers = Mapping[int, Float[np.ndarray, "4 2"]]

ENOUGH_SEEN = 0.5  # of the board's corners, as of a chessboard's
_FITS = 0.3  # of a marker's side: how far a neighbour may be from where it is predicted
_NEAREST = 4  # markers that place a grid point
_REACH = (
    1.5  # squares, from a marker's middle to the grid points it helps to place: its square's own are at .5
)


def detect_charuco(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec
) -> GridPoints:
    """Find the inner corners of a ChArUco board; see `core.targets.detect.detect`."""
    layout = charuco_layout(target)
    markers, repeated = _read_markers(image, layout)
    fitting = fitting_markers(markers, layout)
    if not fitting and repeated:
        raise TargetMismatch(
            f"{len(repeated)} of the ChArUco board's markers are in view more than once.",
            "Cover the other boards with the same markers, and mirrors.",
        )
    if not fitting:
        raise TargetNotFound(
            f"{_counted(len(markers))} of the ChArUco board found, but no two side by side as printed."
            if markers
            else "No marker of the ChArUco board was found.",
            "Show the board sharp, evenly lit and with markers of 20 px and more; check its dictionary, size and "
            "legacy_layout. A mirrored print cannot be read.",
        )
    column, row, places = _place_grid_points(fitting, layout, image.shape)
    seen = len(column)
    if seen >= 4 and len(set(column.tolist())) > 1 and len(set(row.tolist())) > 1:
        refined = refine_corners(
            np.ascontiguousarray(image), column, row, places, origin_is_black=bool(layout.black[1, 1])
        )
        trusted = refined.trusted
    else:
        trusted = np.zeros(seen, dtype=np.bool_)
    count = int(trusted.sum())
    if count < ENOUGH_SEEN * target.size:
        raise TargetNotFound(
            f"{len(fitting)} of the ChArUco board's {len(layout.marker_squares)} markers were found, and "
            f"{count} of its {target.size} corners can be measured: too few.",
            "Bring more of the board into view, free of reflections and of anything in front of it.",
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
        markers_px=fitting,
    )


def detect_markers(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], target: TargetSpec
) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Return the corners (px, in `CharucoLayout.marker_corners`' order) of the board's markers, by OpenCV's detector.

    Its corners are refined by cornerSubPix. An id that was read twice is left out, since nobody knows which is meant.
    Raises InvalidTarget for a target without markers.
    """
    return _read_markers(image, charuco_layout(target))[0]


def _read_markers(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], layout: CharucoLayout
) -> tuple[dict[int, Float[np.ndarray, "4 2"]], set[int]]:
    """Return the corners of the markers seen once, and the ids of those seen several times."""
    grey = image if image.dtype == np.uint8 else (image >> 8).astype(np.uint8)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, ids, _ = cv2.aruco.ArucoDetector(marker_dictionary(layout.target), parameters).detectMarkers(
        grey
    )
    found: dict[int, Float[np.ndarray, "4 2"]] = {}
    repeated: set[int] = set()
    numbers = [] if ids is None else [int(number) for number in ids.ravel()]
    for number, four in zip(numbers, corners, strict=True):
        if number in found:
            repeated.add(number)
        elif number < len(layout.marker_squares):
            found[number] = four.reshape(4, 2).astype(np.float64)
    return {number: found[number] for number in sorted(found.keys() - repeated)}, repeated


def fitting_markers(markers: Markers, layout: CharucoLayout) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Return the largest set of markers that fit the board from neighbour to neighbour; empty for none of two."""
    numbers = sorted(markers)
    maps = {number: _plane_through([number], markers, layout) for number in numbers}
    centres = {number: layout.marker_corners(number).mean(axis=0)[:2] for number in numbers}
    sides = {
        number: float(np.linalg.norm(np.diff(markers[number], axis=0), axis=1).min()) for number in numbers
    }

    def predicts(one: int, other: int) -> bool:
        H = maps[one]
        if H is None:
            return False
        off = _mapped(H, centres[other][None])[0] - markers[other].mean(axis=0)
        return bool(np.linalg.norm(off) < _FITS * sides[other])

    parts: list[set[int]] = []
    for number in numbers:
        joined = {number}
        for part in [p for p in parts if any(_beside(number, other, layout) for other in p)]:
            beside = [other for other in part if _beside(number, other, layout)]
            if any(predicts(number, other) and predicts(other, number) for other in beside):
                parts.remove(part)
                joined |= part
        parts.append(joined)
    largest = max(parts, key=lambda part: (len(part), -min(part)), default=set())
    return {number: markers[number] for number in sorted(largest)} if len(largest) > 1 else {}


def _beside(one: int, other: int, layout: CharucoLayout) -> bool:
    apart = np.abs(layout.marker_squares[one] - layout.marker_squares[other])
    return int(apart.sum()) == 2


def _place_grid_points(
    markers: Markers, layout: CharucoLayout, shape: tuple[int, ...]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Return column, row and place (px) of the grid points in the picture that are near enough to a marker."""
    target = layout.target
    numbers = np.array(sorted(markers))
    squares = layout.marker_squares[numbers]
    height, width = shape
    columns, rows, places = [], [], []
    for row in range(target.rows):
        for column in range(target.columns):
            # square (i, j) has the grid points (i - 1, j - 1) to (i, j) at its corners
            apart = squares - [column + 0.5, row + 0.5]
            if np.abs(apart).max(axis=1).min() > _REACH:
                continue
            nearest = numbers[np.argsort((apart**2).sum(axis=1), kind="stable")[:_NEAREST]]
            H = _plane_through(nearest.tolist(), markers, layout)
            if H is None:
                continue
            u, v = _mapped(H, np.array([[column, row]]) * target.pitch_mm)[0]
            if 0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0:
                columns.append(column)
                rows.append(row)
                places.append((u, v))
    return np.array(columns, np.intp), np.array(rows, np.intp), np.array(places, np.float64).reshape(-1, 2)


def _plane_through(
    numbers: list[int], markers: Markers, layout: CharucoLayout
) -> Float[np.ndarray, "3 3"] | None:
    """Return the homography from the target's plane (mm) to pixels by these markers' corners."""
    corners = np.concatenate([layout.marker_corners(number)[:, :2] for number in numbers])
    H, _ = cv2.findHomography(corners, np.concatenate([markers[number] for number in numbers]))
    return None if H is None or not np.all(np.isfinite(H)) else np.asarray(H, np.float64)


def _mapped(H: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Return the points' pixels; far outside of any picture where the plane ends before them."""
    ahead = points @ H[:, :2].T + H[:, 2]
    scale = np.where(ahead[:, 2:] > 1e-9, ahead[:, 2:], 1e-9)
    return np.asarray(ahead[:, :2] / scale)


def _counted(markers: int) -> str:
    return "One marker" if markers == 1 else f"{markers} markers"


def _left_out(count: int, size: int) -> Advisory:
    return Advisory(
        code="corners_left_out",
        detail=f"{count} of {size} corners were left out: they are out of view, no marker near them was read, or the "
        "picture does not show them as corners of squares.",
        advice="Look at the overlay: reflections, dirt or something in front of the grid are the usual causes.",
    )
