"""A board's markers by OpenCV's detector alone."""

from __future__ import annotations

import numpy as np

from core.targets import TargetSpec, charuco_layout
from core.targets.charuco.isolated_markers import detect_isolated_markers


def detect_markers(image: np.ndarray, target: TargetSpec) -> dict[int, np.ndarray]:
    """Return the corners (px, in `CharucoLayout.marker_corners`' order) of the board's markers.

    An id that was read twice is excluded, since it is ambiguous. Raises InvalidTarget for a target without markers.
    """
    layout = charuco_layout(target)
    markers, _ = detect_isolated_markers(image, layout)
    return {number: corners for number, corners in markers.items() if number < len(layout.marker_squares)}
