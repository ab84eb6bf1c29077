"""OpenCV's ArucoDetector, then cornerSubPix with a window that fits: the corners of the markers themselves.

The detector's own refinement (CORNER_REFINE_SUBPIX) is several times less accurate on these sheets.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from benchmarks.public.adapters import NOTHING, Found

STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
MIN_WINDOW, MAX_WINDOW = 2, 11


@dataclass(frozen=True, slots=True)
class Prepared:
    """Detector, labels (markers, 4), and half the refinement's window as a fraction of a marker's side."""

    detector: Any
    labels: np.ndarray
    window_of_side: float


def prepare(target: Any) -> Any | None:
    if target.kind not in ("charuco", "aprilgrid"):
        return None
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    if target.kind == "charuco":
        name, border, margin_mm = target.dictionary, 1, 0.5 * (target.pitch_mm - target.marker_mm)
    else:
        name, border, margin_mm = "DICT_APRILTAG_36h11", 2, target.pitch_mm - target.marker_mm
    parameters.markerBorderBits = border
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    border_mm = target.marker_mm * border / (dictionary.markerSize + 2 * border)
    window = 0.5 * min(margin_mm, border_mm) / target.marker_mm
    return Prepared(cv2.aruco.ArucoDetector(dictionary, parameters), labels_of_markers(target), window)


def detect(prepared: Prepared, image: np.ndarray) -> Found:
    corners, numbers, _ = prepared.detector.detectMarkers(image)
    if numbers is None:
        return NOTHING
    seen = [
        (number, np.asarray(marker, np.float32).reshape(4, 2))
        for number, marker in zip(numbers.ravel(), corners, strict=True)
        if number < len(prepared.labels)
    ]
    if not seen:
        return NOTHING
    points = np.concatenate([marker for _, marker in seen])
    sides = [np.linalg.norm(np.diff(marker, axis=0), axis=1).min() for _, marker in seen]
    window = int(np.clip(prepared.window_of_side * np.median(sides), MIN_WINDOW, MAX_WINDOW))
    refined = cv2.cornerSubPix(image, points.reshape(-1, 1, 2), (window, window), (-1, -1), STOP)
    labels = np.concatenate([prepared.labels[number] for number, _ in seen])
    return labels, refined.reshape(-1, 2).astype(np.float64)


def labels_of_markers(target: Any) -> np.ndarray:
    """Return the labels (markers, 4) of each marker's corners, clockwise from the upper left as OpenCV draws it."""
    if target.kind == "charuco":
        count = (target.columns + 1) * (target.rows + 1) // 2
        return target.columns * target.rows + np.arange(4 * count).reshape(count, 4)
    # Id 0 of an AprilGrid is at the upper right of the target frame, and ids count to the left, row by row.
    number = np.arange(target.columns * target.rows)
    column, row = target.columns - 1 - number % target.columns, number // target.columns
    upper_left = 2 * row * 2 * target.columns + 2 * column
    below = 2 * target.columns
    return np.stack([upper_left, upper_left + 1, upper_left + below + 1, upper_left + below], axis=1)
