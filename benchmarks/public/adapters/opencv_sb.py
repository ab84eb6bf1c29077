"""OpenCV's sector-based detector with its flags for accuracy and for an exhaustive search.

Reference: A. Duda, U. Frese, "Accurate detection and localization of checkerboard corners for calibration", BMVC 2018.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from benchmarks.public.adapters import NOTHING, Found

FLAGS = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


def prepare(target: Any) -> Any | None:
    return (target.columns, target.rows) if target.kind == "chessboard" else None


def detect(prepared: Any, image: np.ndarray) -> Found:
    found, corners = cv2.findChessboardCornersSB(image, prepared, flags=FLAGS)
    if not found:
        return NOTHING
    points = corners.reshape(-1, 2).astype(np.float64)
    return np.arange(len(points)), points
