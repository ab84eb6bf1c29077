"""OpenCV's marker detector on images with thousands of quadrangles, such as those of a checkered floor.

The detector compares every quadrangle with every other, so that its time grows with their number squared. Where there
are many, those with nothing bright inside a black border are skipped, for a marker has something there: what is left
of the image then is the surroundings of the others, some hundreds at a time. The quadrangles are found as the detector
finds them, so that it finds the same markers.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

_MANY = 500
"""Quadrangles: comparing so many with each other takes some 50 ms."""
_AT_A_TIME = 300
_SLACK = 0.8  # of the detector's own limits for the size of quadrangles
_AROUND, _AROUND_PX = 0.5, 26
"""Of a quadrangle's extent, and px: the widest window of the detector's threshold."""
_LOOKS = 2  # along a cell
_OUTSIDE = 0.12  # of a marker's side: where its white margin is
_MIN_BRIGHT_LEVELS, _MIN_BRIGHT = 4.0, 0.2
"""Grey levels, and of the contrast: how far a marker's white cell is above black."""
_MIN_BLACK_BORDER = 0.5  # of the border's cells; the detector asks for .65
_SAME = 0.5  # of a marker's side: what is nearer is the same marker

Marker = tuple[int, Float[np.ndarray, "4 2"]]


def markers_in_parts(
    grey: UInt8[np.ndarray, "h w"], dictionary: Any, parameters: cv2.aruco.DetectorParameters
) -> list[Marker]:
    """Return id and corners (px) of the markers that OpenCV's detector finds, in a time that grows with their number.

    A marker in view twice is returned twice.
    """
    middle = parameters.adaptiveThreshWinSizeMin + parameters.adaptiveThreshWinSizeStep
    if len(_quadrangles(grey, middle, parameters)) <= _MANY:
        return list(_detected(grey, dictionary, parameters))
    windows = range(
        parameters.adaptiveThreshWinSizeMin,
        parameters.adaptiveThreshWinSizeMax + 1,
        parameters.adaptiveThreshWinSizeStep,
    )
    every = np.concatenate([_quadrangles(grey, window, parameters) for window in windows])
    quads = every[_may_be_markers(grey, every, int(dictionary.markerSize) + 2)]
    quads = quads[np.argsort(quads[:, :, 1].mean(axis=1), kind="stable")]
    found: list[Marker] = []
    for first in range(0, len(quads), _AT_A_TIME):
        for number, corners in _detected_around(
            grey, quads[first : first + _AT_A_TIME], dictionary, parameters
        ):
            side = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).min())
            if not any(
                number == other and np.linalg.norm(places.mean(axis=0) - corners.mean(axis=0)) < _SAME * side
                for other, places in found
            ):
                found.append((number, corners))
    return found


def _detected(
    grey: UInt8[np.ndarray, "h w"], dictionary: Any, parameters: cv2.aruco.DetectorParameters
) -> Iterator[Marker]:
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    numbers = [] if ids is None else [int(number) for number in ids.ravel()]
    for number, four in zip(numbers, corners, strict=True):
        yield number, four.reshape(4, 2).astype(np.float64)


def _detected_around(
    grey: UInt8[np.ndarray, "h w"],
    quads: Float[np.ndarray, "n 4 2"],
    dictionary: Any,
    parameters: cv2.aruco.DetectorParameters,
) -> Iterator[Marker]:
    """Yield the markers in some quadrangles, by the image without what is not near one of them."""
    low, high = quads.min(axis=1), quads.max(axis=1)
    around = _AROUND * (high - low) + _AROUND_PX
    size = np.array(grey.shape[::-1])
    low, high = (
        np.clip(np.rint(ends), 0, size).astype(np.intp) for ends in (low - around, high + around + 1.0)
    )
    first, last = low.min(axis=0), high.max(axis=0)
    is_near = np.zeros(grey.shape, dtype=np.bool_)
    for (left, top), (right, bottom) in zip(low, high, strict=True):
        is_near[top:bottom, left:right] = True
    part = np.s_[first[1] : last[1], first[0] : last[0]]
    seen = np.where(is_near[part], grey[part], np.uint8(128))
    scale = max(grey.shape) / max(seen.shape)  # the detector's limits are shares of the image's longer side
    least, most = parameters.minMarkerPerimeterRate, parameters.maxMarkerPerimeterRate
    parameters.minMarkerPerimeterRate, parameters.maxMarkerPerimeterRate = scale * least, scale * most
    try:
        for number, corners in _detected(np.ascontiguousarray(seen), dictionary, parameters):
            yield number, corners + first
    finally:
        parameters.minMarkerPerimeterRate, parameters.maxMarkerPerimeterRate = least, most


def _quadrangles(
    grey: UInt8[np.ndarray, "h w"], window: int, parameters: cv2.aruco.DetectorParameters
) -> Float[np.ndarray, "n 4 2"]:
    """Return the convex quadrangles that the detector sees with one window of its threshold, clockwise, px."""
    dark = cv2.adaptiveThreshold(
        grey,
        255,
        cv2.ADAPTIVE_THRESH_MEAN_C,
        cv2.THRESH_BINARY_INV,
        window,
        parameters.adaptiveThreshConstant,
    )
    outlines, _ = cv2.findContours(dark, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    least = _SLACK * parameters.minMarkerPerimeterRate * max(grey.shape)
    found = []
    for outline in outlines:
        if len(outline) < least:
            continue
        corners = cv2.approxPolyDP(outline, parameters.polygonalApproxAccuracyRate * len(outline), True)
        if len(corners) == 4 and cv2.isContourConvex(corners):
            found.append(corners.reshape(4, 2))
    quads = np.array(found, dtype=np.float64).reshape(-1, 4, 2)
    one, other = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    turned = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] < 0.0
    quads[turned] = quads[turned, ::-1]
    return quads


def _may_be_markers(
    grey: UInt8[np.ndarray, "h w"], quads: Float[np.ndarray, "n 4 2"], cells: int
) -> Bool[np.ndarray, " n"]:
    """Return which quadrangles have something bright inside a black border, `cells` along a side."""
    across = (np.arange(cells * _LOOKS) + 0.5) / (cells * _LOOKS)
    shape = (len(quads), cells, _LOOKS, cells, _LOOKS)
    means = _greys(grey, quads, *np.meshgrid(across, across)).reshape(shape).mean(axis=(2, 4))
    around = np.concatenate(
        [across, across, np.full_like(across, -_OUTSIDE), np.full_like(across, 1.0 + _OUTSIDE)]
    )
    white = _greys(grey, quads, around, np.roll(around, len(around) // 2))
    outside = np.median(white, axis=1)
    is_border = np.ones((cells, cells), dtype=np.bool_)
    is_border[1:-1, 1:-1] = False
    black = np.median(means[:, is_border], axis=1)
    above = np.maximum(_MIN_BRIGHT * (outside - black), _MIN_BRIGHT_LEVELS)[:, None]
    inside = means[:, ~is_border] - black[:, None] > above
    border = means[:, is_border] - black[:, None] <= np.maximum(0.5 * (outside - black)[:, None], above)
    return (outside > black) & inside.any(axis=1) & (border.mean(axis=1) >= _MIN_BLACK_BORDER)


def _greys(
    grey: UInt8[np.ndarray, "h w"], quads: Float[np.ndarray, "n 4 2"], x: np.ndarray, y: np.ndarray
) -> Float32[np.ndarray, "n k"]:
    """Return the grey values at places of the quadrangles, from their first corner (0, 0) to their third (1, 1)."""
    x, y = x.ravel(), y.ravel()
    weights = np.stack([(1.0 - x) * (1.0 - y), x * (1.0 - y), x * y, (1.0 - x) * y]).astype(np.float32)
    u, v = (
        np.clip(np.rint(quads[:, :, axis].astype(np.float32) @ weights).astype(np.int32), 0, last)
        for axis, last in ((0, grey.shape[1] - 1), (1, grey.shape[0] - 1))
    )
    return grey.ravel()[v * np.int32(grey.shape[1]) + u].astype(np.float32)
