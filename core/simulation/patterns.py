"""What is printed: the sheet as cells between straight lines, each with its ink."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import InvalidTarget
from core.targets.charuco_layout import charuco_layout
from core.targets.specification import TargetSpec


@dataclass(frozen=True, slots=True)
class RectilinearPattern:
    """A sheet whose inks are bounded by lines x = x_edges[i] and y = y_edges[j], in the target frame, mm.

    `white` (rows of cells, columns of cells) is 1 where the cell is white, 0 where it is black or no sheet at
    all; `sheet` is 1 where there is sheet. The cell (j, i) lies between edges j-1 and j, i-1 and i; the
    outermost cells reach to infinity. Chessboards and square markers alike are of this form.
    """

    x_edges: Float[np.ndarray, " nx"]
    y_edges: Float[np.ndarray, " ny"]
    white: Float[np.ndarray, "ny+1 nx+1"]
    sheet: Float[np.ndarray, "ny+1 nx+1"]


def pattern_of(target: TargetSpec, quiet_zone: float) -> RectilinearPattern:
    """Return the sheet of a target with a white margin of `quiet_zone` pitches around it.

    Raises
    ------
    InvalidTarget
        This kind cannot be rendered, or its markers cannot be printed as stated.
    """
    if target.kind == "chessboard":
        return _chessboard(target, quiet_zone)
    if target.kind == "charuco":
        return _charuco(target, quiet_zone)
    raise InvalidTarget(f"A target of kind {target.kind!r} cannot be rendered.")


def _chessboard(target: TargetSpec, quiet_zone: float) -> RectilinearPattern:
    """Return (columns + 1) x (rows + 1) squares; the one beyond grid point (0, 0) is black, as are all whose
    indices from there have an even sum."""
    edges = [np.arange(-1.0, count + 1.0) * target.pitch_mm for count in (target.columns, target.rows)]
    j, i = np.mgrid[0 : target.rows + 1, 0 : target.columns + 1]
    return _sheet(edges[0], edges[1], ((i + j) % 2).astype(np.float64), quiet_zone * target.pitch_mm)


def _charuco(target: TargetSpec, quiet_zone: float) -> RectilinearPattern:
    """Return the squares, each cut by the lines of the marker that stands in it or in others of its row and column."""
    layout = charuco_layout(target)
    cells = layout.marker_cells.shape[1]
    # Within a square: its margin, the marker's cells, the other margin.
    inside = 0.5 * (target.pitch_mm - layout.marker_mm) + np.arange(cells + 1) * layout.marker_mm / cells
    steps = np.concatenate([[0.0], inside])
    edges = [
        np.append(
            (np.arange(-1.0, count)[:, None] * target.pitch_mm + steps).ravel(), count * target.pitch_mm
        )
        for count in (target.columns, target.rows)
    ]
    parts = cells + 2
    white = np.kron(~layout.black, np.ones((parts, parts)))
    for (i, j), picture in zip(layout.marker_squares, layout.marker_cells, strict=True):
        first_row, first_column = j * parts + 1, i * parts + 1
        white[first_row : first_row + cells, first_column : first_column + cells] = picture
    return _sheet(edges[0], edges[1], white, quiet_zone * target.pitch_mm)


def _sheet(
    x_edges: Float[np.ndarray, " nx"],
    y_edges: Float[np.ndarray, " ny"],
    white: Float[np.ndarray, "ny-1 nx-1"],
    margin_mm: float,
) -> RectilinearPattern:
    """Return the printed cells with a white margin around them and nothing beyond."""
    margin = max(margin_mm, 0.0)
    x, y = (np.concatenate([[e[0] - margin], e, [e[-1] + margin]]) for e in (x_edges, y_edges))
    framed = np.pad(np.pad(white, 1, constant_values=1.0), 1)
    return RectilinearPattern(x, y, framed, np.pad(np.ones((len(y) - 1, len(x) - 1)), 1))
