"""Where a ChArUco board's markers stand and what is printed in them.

The board has (columns + 1) x (rows + 1) squares; square (i, j) ends at grid point (i, j). Markers, centred in the
white squares, carry the dictionary's first ids, row by row. The square beyond grid point (0, 0) is black, except in
OpenCV's layout of before 4.6 (`legacy_layout`) with an even number of rows of squares, where it is white.

References: S. Garrido-Jurado, R. Muñoz-Salinas, F. J. Madrid-Cuevas, M. J. Marín-Jiménez, "Automatic generation and
detection of highly reliable fiducial markers under occlusion", Pattern Recognition 47 (2014) 2280-2292,
10.1016/j.patcog.2014.01.005; OpenCV's documentation of `CharucoBoard.setLegacyPattern`.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from core.errors import InvalidTarget
from core.targets.markers import marker_bits
from core.targets.specification import TargetSpec


@dataclass(frozen=True, slots=True)
class CharucoLayout:
    """The squares and markers of one board.

    `black` (rows + 1, columns + 1) holds the squares' colours; marker k has id k and lies in the square
    `marker_squares[k]` = (i, j). `marker_cells` (markers, m, m) are the cells of its pattern, 1 where white, its
    black border of one cell included.
    """

    target: TargetSpec
    marker_mm: float
    black: Bool[np.ndarray, "r c"]
    marker_squares: Int[np.ndarray, "k 2"]
    marker_cells: Float[np.ndarray, "k m m"]

    @property
    def margin(self) -> float:
        """The width of the white around a marker, in squares."""
        return 0.5 * (1.0 - self.marker_mm / self.target.pitch_mm)

    @property
    def cell(self) -> float:
        """The size of a marker's cells, in squares."""
        return self.marker_mm / self.target.pitch_mm / self.marker_cells.shape[1]

    def marker_corners(self, marker: int) -> Float[np.ndarray, "4 3"]:
        """Return a marker's corners in the target frame, mm: from its upper left, clockwise as seen."""
        if not 0 <= marker < len(self.marker_squares):
            raise InvalidTarget(f"The board has markers 0 to {len(self.marker_squares) - 1}, not {marker}.")
        i, j = self.marker_squares[marker]
        centre = (np.array([i, j, 0.0]) - [0.5, 0.5, 0.0]) * self.target.pitch_mm
        signs = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
        return np.asarray(centre + 0.5 * self.marker_mm * signs)


@lru_cache(maxsize=32)
def charuco_layout(target: TargetSpec) -> CharucoLayout:
    """Return the layout of a target of kind `charuco`; its arrays are shared, and may not be written to.

    Raises InvalidTarget for another kind, an unknown dictionary or one with too few markers, and markers that do not
    fit into the squares.
    """
    dictionary = marker_dictionary(target)
    marker_mm = target.marker_mm
    if marker_mm is None:
        raise InvalidTarget(
            "marker_mm is required for ChArUco boards.",
            "Measure a marker from black edge to black edge.",
            field="marker_mm",
        )
    if not 0.0 < marker_mm < target.pitch_mm:
        raise InvalidTarget(
            f"A ChArUco board's marker_mm must be positive and less than its pitch_mm, got {marker_mm!r}.",
            "Measure a marker from black edge to black edge, and a square.",
            field="marker_mm",
        )
    j, i = np.mgrid[0 : target.rows + 1, 0 : target.columns + 1]
    white_start = target.legacy_layout and (target.rows + 1) % 2 == 0
    black = (i + j) % 2 == (1 if white_start else 0)
    rows, columns = np.nonzero(~black)
    available = len(dictionary.bytesList)
    if len(rows) > available:
        raise InvalidTarget(
            f"The board needs {len(rows)} markers, {target.dictionary} has {available}.",
            "Use a larger dictionary of the same marker size, or fewer squares.",
            field="dictionary",
        )
    bits = marker_bits(str(target.dictionary))[: len(rows)]
    layout = CharucoLayout(
        target=target,
        marker_mm=float(marker_mm),
        black=black,
        marker_squares=np.stack([columns, rows], axis=1),
        marker_cells=np.pad(bits.astype(np.float64), ((0, 0), (1, 1), (1, 1))),
    )
    for array in (layout.black, layout.marker_squares, layout.marker_cells):
        array.flags.writeable = False
    return layout


def legacy_counterpart(layout: CharucoLayout) -> CharucoLayout:
    """Return the same board's layout with the other `legacy_layout`; of an odd number of rows of squares the same."""
    target = layout.target
    return charuco_layout(replace(target, legacy_layout=not target.legacy_layout))


def column_offset(markers: Collection[int], layout: CharucoLayout) -> int:
    """Return by how many columns the other `legacy_layout` displaces all of these markers; 0 where it does not.

    With an even number of rows of squares the two have the same ids a column apart: on boards with an odd number of
    columns of squares all to one side, but for one marker of a pair of rows; else to one side in the even rows and to
    the other in the odd ones, so that markers of both distinguish the layouts.
    """
    numbers = sorted(markers)
    apart = np.unique(
        legacy_counterpart(layout).marker_squares[numbers] - layout.marker_squares[numbers], axis=0
    )
    return int(apart[0, 0]) if len(apart) == 1 and apart[0, 1] == 0 else 0


def marker_dictionary(target: TargetSpec) -> Any:
    """Return OpenCV's dictionary of a ChArUco target. Raises InvalidTarget for another kind or an unknown name."""
    if target.kind != "charuco":
        raise InvalidTarget(f"A target of kind {target.kind!r} has no ChArUco markers.")
    name = target.dictionary
    if name is None:
        raise InvalidTarget(
            "dictionary is required for ChArUco boards.",
            "Use OpenCV's name, for example DICT_6X6_250.",
            field="dictionary",
        )
    number = getattr(cv2.aruco, name, None) if name.startswith("DICT_") else None
    if number is None:
        raise InvalidTarget(
            f"Unknown marker dictionary {name!r}.",
            "Use OpenCV's name, for example DICT_6X6_250.",
            field="dictionary",
        )
    return cv2.aruco.getPredefinedDictionary(number)
