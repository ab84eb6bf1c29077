"""A ChArUco board's markers as OpenCV's detector finds them, and the grid points that they place.

This is the slow way, for images in which the squares' corners make no lattice (`core.targets.charuco.placement`):
squares of a few px, or few of them in view. OpenCV's detector finds and decodes the markers. A marker is
rejected, whatever its id, if it does not fit the board together with a neighbour: the four corners of one
marker predict those of the next one. Lens distortion hardly affects this prediction, and a misread marker does
not satisfy it. Each grid point next to a marker, or one square further, is placed by the plane through the
markers nearest to it.

Reference: Garrido-Jurado et al. 2014 as in `core.targets.charuco.layout`.
"""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8, UInt16

from core.geometry import find_homography, map_in_front
from core.targets.charuco.layout import CharucoLayout, marker_dictionary
from core.targets.charuco.quadrangles import markers_in_parts

Markers = Mapping[int, Float[np.ndarray, "4 2"]]

_FITS = 0.3  # of a marker's side: how far a neighbour may be from where it is predicted
_NEAREST = 4  # markers that place a grid point
_REACH = (
    1.5  # squares, from a marker's middle to the grid points it helps to place: its square's own are at .5
)
_STRAYS = 1.0  # of a marker's side: one read on the board farther from its place contradicts the others


def detect_isolated_markers(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], layout: CharucoLayout
) -> tuple[dict[int, Float[np.ndarray, "4 2"]], set[int]]:
    """Return the corners of the dictionary's markers seen once, and the ids of the board's seen several times."""
    found: dict[int, Float[np.ndarray, "4 2"]] = {}
    repeated: set[int] = set()
    for number, corners in markers_in_parts(
        _eight_bit(image), marker_dictionary(layout.target), _parameters()
    ):
        if number in found:
            repeated.add(number)
        else:
            found[number] = corners
    own = {number for number in repeated if number < len(layout.marker_squares)}
    return {number: found[number] for number in sorted(found.keys() - repeated)}, own


def refined_markers(
    image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"], markers: Markers, layout: CharucoLayout
) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Return the corners of markers that are known to a px, refined by cornerSubPix as OpenCV's detector refines its
    own: in windows of its size, to its accuracy."""
    if not markers:
        return {}
    parameters = _parameters()
    numbers = sorted(markers)
    corners = np.array([markers[number] for number in numbers], dtype=np.float32)
    perimeter = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).sum(axis=1)
    module = perimeter / (4.0 * layout.marker_cells.shape[1])
    size = np.rint(parameters.relativeCornerRefinmentWinSize * module).astype(int)
    size = np.clip(size, 1, parameters.cornerRefinementWinSize)
    steps, accuracy = parameters.cornerRefinementMaxIterations, parameters.cornerRefinementMinAccuracy
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, steps, accuracy)
    grey = _eight_bit(image)
    for window in set(size.tolist()):
        chosen = size == window
        some = np.ascontiguousarray(corners[chosen].reshape(-1, 1, 2))
        cv2.cornerSubPix(grey, some, (window, window), (-1, -1), criteria)
        corners[chosen] = some.reshape(-1, 4, 2)
    return dict(zip(numbers, corners.astype(np.float64), strict=True))


def _parameters() -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return parameters


def _eight_bit(image: UInt8[np.ndarray, "h w"] | UInt16[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    return image if image.dtype == np.uint8 else (image >> 8).astype(np.uint8)


def consistent_markers(markers: Markers, layout: CharucoLayout) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Return the largest set of markers that fit the board from neighbour to neighbour; empty for none of two."""
    numbers = sorted(number for number in markers if number < len(layout.marker_squares))
    maps = {number: _plane_through([number], markers, layout) for number in numbers}
    centres = {number: layout.marker_corners(number).mean(axis=0)[:2] for number in numbers}
    sides = {number: _side(markers[number]) for number in numbers}

    def predicts(one: int, other: int) -> bool:
        H = maps[one]
        if H is None:
            return False
        off = map_in_front(H, centres[other][None])[0] - markers[other].mean(axis=0)
        return bool(np.linalg.norm(off) < _FITS * sides[other])

    parts: list[set[int]] = []
    for number in numbers:
        joined = {number}
        for part in [p for p in parts if any(_are_adjacent(number, other, layout) for other in p)]:
            adjacent = [other for other in part if _are_adjacent(number, other, layout)]
            if any(predicts(number, other) and predicts(other, number) for other in adjacent):
                parts.remove(part)
                joined |= part
        parts.append(joined)
    largest = max(parts, key=lambda part: (len(part), -min(part)), default=set())
    return {number: markers[number] for number in sorted(largest)} if len(largest) > 1 else {}


def outlier_markers(markers: Markers, fitting: Markers, layout: CharucoLayout) -> set[int]:
    """Return the markers that were read where the fitting ones have the board, but not at their own places on it."""
    H = _plane_through(sorted(fitting), markers, layout)
    if H is None:
        return set(markers) - set(fitting)
    target = layout.target
    low, high = -0.5 * target.pitch_mm, np.array([target.columns, target.rows]) * target.pitch_mm
    strays = set()
    for number in set(markers) - set(fitting):
        centre = markers[number].mean(axis=0)
        x, y = map_in_front(np.linalg.inv(H), centre[None])[0]
        if not (low <= x <= high[0] and low <= y <= high[1]):
            continue
        if number < len(layout.marker_squares):
            own = map_in_front(H, layout.marker_corners(number).mean(axis=0)[None, :2])[0]
            if np.linalg.norm(own - centre) <= _STRAYS * _side(markers[number]):
                continue
        strays.add(number)
    return strays


def place_grid_points(
    markers: Markers, layout: CharucoLayout, shape: tuple[int, ...]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Return column, row and place (px) of the grid points in the image that are near enough to a marker."""
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
            u, v = map_in_front(H, np.array([[column, row]]) * target.pitch_mm)[0]
            if 0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0:
                columns.append(column)
                rows.append(row)
                places.append((u, v))
    return np.array(columns, np.intp), np.array(rows, np.intp), np.array(places, np.float64).reshape(-1, 2)


def _side(corners: Float[np.ndarray, "4 2"]) -> float:
    """Return the shortest of a marker's sides, px."""
    return float(np.linalg.norm(np.diff(corners, axis=0), axis=1).min())


def _are_adjacent(one: int, other: int, layout: CharucoLayout) -> bool:
    apart = np.abs(layout.marker_squares[one] - layout.marker_squares[other])
    return int(apart.sum()) == 2


def _plane_through(
    numbers: list[int], markers: Markers, layout: CharucoLayout
) -> Float[np.ndarray, "3 3"] | None:
    """Return the homography from the target's plane (mm) to pixels by these markers' corners."""
    corners = np.concatenate([layout.marker_corners(number)[:, :2] for number in numbers])
    return find_homography(corners, np.concatenate([markers[number] for number in numbers]))
