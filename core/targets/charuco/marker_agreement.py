"""Whether markers that agree where a ChArUco board lies are enough to believe them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from core.targets.charuco.layout import CharucoLayout
from core.targets.markers import MarkerDictionary

_CONTRARY = 0.2  # of the markers that agree: so many may contradict them, misread or pasted there


def is_inconsistent(conflicting: int, agreeing: int) -> bool:
    """Return whether more markers contradict those that agree than dirt explains."""
    return conflicting > _CONTRARY * agreeing


def has_enough_markers(markers: Collection[int], layout: CharucoLayout, codes: MarkerDictionary) -> bool:
    """Return whether enough markers agree to place the board: not by chance, and in rows that determine its width."""
    rows = layout.marker_squares[sorted(markers), 1]
    if len(rows) < codes.least_agreeing or np.ptp(rows) == 0:
        return False
    return bool(np.ptp(rows) > 1) or not _fit_another_width(sorted(markers), layout)


def _fit_another_width(markers: list[int], layout: CharucoLayout) -> bool:
    """Return whether a wider or narrower board has all of these markers in the same places, but for a displacement.

    Markers are numbered row by row, and a row has half as many as squares, rounded: in two adjacent rows boards of
    about one width differ at the ends of rows alone.
    """
    squares, width = layout.marker_squares[markers], layout.target.columns + 1
    for other in (width - 2, width - 1, width + 1, width + 2):
        rows = 2 * (markers[-1] + 1) // max(other - 1, 1) + 2
        for parity in range(2):
            places = [(i, j) for j in range(rows) for i in range(other) if (i + j) % 2 == parity]
            if len(np.unique(np.array(places)[markers] - squares, axis=0)) == 1:
                return True
    return False
