"""OpenCV's CharucoDetector as it comes: markers, then the chessboard corners between them, refined."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from benchmarks.public.adapters import NOTHING, Found


def prepare(target: Any) -> Any | None:
    if target.kind != "charuco":
        return None
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, target.dictionary))
    size = (target.columns + 1, target.rows + 1)
    return cv2.aruco.CharucoDetector(
        cv2.aruco.CharucoBoard(size, target.pitch_mm, target.marker_mm, dictionary)
    )


def detect(prepared: Any, image: np.ndarray) -> Found:
    corners, labels, _, _ = prepared.detectBoard(image)
    if labels is None or len(labels) == 0:
        return NOTHING
    return labels.ravel().astype(np.intp), corners.reshape(-1, 2).astype(np.float64)
