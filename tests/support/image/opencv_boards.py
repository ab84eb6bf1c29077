"""Boards as OpenCV makes them, to compare ours with."""

from __future__ import annotations

import cv2

from core.targets.specification import TargetSpec


def opencv_board(target: TargetSpec) -> cv2.aruco.CharucoBoard:
    """Return OpenCV's board of a ChArUco target."""
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(target.dictionary)))
    size = (target.columns + 1, target.rows + 1)
    board = cv2.aruco.CharucoBoard(size, target.pitch_mm, float(target.marker_mm or 0.0), dictionary)
    board.setLegacyPattern(target.legacy_layout)
    return board
