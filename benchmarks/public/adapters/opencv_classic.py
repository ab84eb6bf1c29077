"""OpenCV's classic way to a chessboard: findChessboardCorners, then cornerSubPix with a window that fits the cells."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from benchmarks.public.adapters import NOTHING, Found

STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
MAX_WINDOW = 11
WINDOW_OF_PITCH = 0.4
"""Half the window as a fraction of the smallest distance of neighbours: a larger one reaches the next corner."""


def prepare(target: Any) -> Any | None:
    return (target.columns, target.rows) if target.kind == "chessboard" else None


def detect(prepared: Any, image: np.ndarray) -> Found:
    found, corners = cv2.findChessboardCorners(image, prepared)
    if not found:
        return NOTHING
    grid = corners.reshape(prepared[1], prepared[0], 2)
    spacing = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min()) for axis in (0, 1))
    window = int(np.clip(WINDOW_OF_PITCH * spacing, 2, MAX_WINDOW))
    refined = cv2.cornerSubPix(image, corners.reshape(-1, 1, 2), (window, window), (-1, -1), STOP)
    return np.arange(len(refined)), refined.reshape(-1, 2).astype(np.float64)
