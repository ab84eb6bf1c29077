"""What is printed: the sheet as cells between straight lines, each with its ink, or as dots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import InvalidTarget
from core.targets.aprilgrid import BORDER_CELLS, TAG_CELLS, aprilgrid_layout
from core.targets.charuco import charuco_layout
from core.targets.chessboard import mark_diameter_mm, marked_squares
from core.targets.specification import TargetSpec


@dataclass(frozen=True, slots=True)
class RectilinearPattern:
    """A sheet whose inks are bounded by lines x = x_edges[i] and y = y_edges[j], in the target frame, mm.

    `white` (rows of cells, columns of cells) is 1 where the cell is white, 0 where it is black or no sheet at
    all; `sheet` is 1 where there is sheet. The cell (j, i) lies between edges j-1 and j, i-1 and i; the
    outermost cells reach to infinity. Both chessboards and square markers are of this form.
    """

    x_edges: Float[np.ndarray, " nx"]
    y_edges: Float[np.ndarray, " ny"]
    white: Float[np.ndarray, "ny+1 nx+1"]
    sheet: Float[np.ndarray, "ny+1 nx+1"]


@dataclass(frozen=True, slots=True)
class DotPattern:
    """A sheet with dots on a square lattice, which may stand askew, each of the other colour than what is under it.

    The lattice index (p, q) of a place (x, y) in the target frame, mm, is `to_index` (x, y); `radius_mm` (rows of q,
    columns of p, from `first` on) is 0 where the lattice has no dot. `blank` is the sheet without them.
    """

    blank: RectilinearPattern
    to_index: Float[np.ndarray, "2 2"]
    first: tuple[float, float]
    radius_mm: Float[np.ndarray, "nq np"]

    @property
    def x_edges(self) -> Float[np.ndarray, " nx"]:
        """Where the sheet begins and ends, mm."""
        return self.blank.x_edges

    @property
    def y_edges(self) -> Float[np.ndarray, " ny"]:
        """The same along y."""
        return self.blank.y_edges


def pattern_of(
    target: TargetSpec, quiet_zone: float, origin_dot: float = 1.0, *, marks: bool = False
) -> RectilinearPattern | DotPattern:
    """Return the sheet of a target with a white margin of `quiet_zone` pitches around it; the dot at the origin of a
    board of dots is `origin_dot` times as wide as the others, and a chessboard carries its `marks` on request.

    Raises
    ------
    InvalidTarget
        This kind cannot be rendered, or its markers cannot be printed as stated.
    """
    if target.kind == "chessboard":
        plain = _chessboard(target, quiet_zone)
        return _marked(plain, target) if marks else plain
    if target.kind == "charuco":
        return _charuco(target, quiet_zone)
    if target.kind in ("circles", "asymmetric_circles"):
        return _dots(target, quiet_zone, origin_dot)
    if target.kind == "aprilgrid":
        return _aprilgrid(target, quiet_zone)
    raise InvalidTarget(f"A target of kind {target.kind!r} cannot be rendered.")


def _chessboard(target: TargetSpec, quiet_zone: float) -> RectilinearPattern:
    """Return (columns + 1) x (rows + 1) squares; the one beyond grid point (0, 0) is black, as are all whose
    indices from there have an even sum."""
    edges = [np.arange(-1.0, count + 1.0) * target.pitch_mm for count in (target.columns, target.rows)]
    j, i = np.mgrid[0 : target.rows + 1, 0 : target.columns + 1]
    return _sheet(edges[0], edges[1], ((i + j) % 2).astype(np.float64), quiet_zone * target.pitch_mm)


def _marked(plain: RectilinearPattern, target: TargetSpec) -> DotPattern:
    """Return a chessboard with a dot in the middle of each of its marked squares."""
    squares = np.array(marked_squares(target))
    if len(squares) == 0:
        raise InvalidTarget(f"On a target of {target.columns} x {target.rows} marks have no room.")
    low = squares.min(axis=0)
    radius = np.zeros(tuple((squares.max(axis=0) - low + 1)[::-1]))
    radius[squares[:, 1] - low[1], squares[:, 0] - low[0]] = 0.5 * mark_diameter_mm(target)
    return DotPattern(plain, np.eye(2) / target.pitch_mm, (float(low[0]) + 0.5, float(low[1]) + 0.5), radius)


def _charuco(target: TargetSpec, quiet_zone: float) -> RectilinearPattern:
    """Return the squares, each cut by the lines of the markers in it and in others of its row and column."""
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
    for (i, j), cell_values in zip(layout.marker_squares, layout.marker_cells, strict=True):
        first_row, first_column = j * parts + 1, i * parts + 1
        white[first_row : first_row + cells, first_column : first_column + cells] = cell_values
    return _sheet(edges[0], edges[1], white, quiet_zone * target.pitch_mm)


def _aprilgrid(target: TargetSpec, quiet_zone: float) -> RectilinearPattern:
    """Return the tags cell by cell, and the squares in the gaps' crossings, those beyond the outermost tags too."""
    layout = aprilgrid_layout(target)
    cells = np.arange(TAG_CELLS + 1) * (layout.tag_mm / TAG_CELLS)
    edges = []
    for count in (target.columns, target.rows):
        lines = (np.arange(count)[:, None] * target.pitch_mm + cells).ravel()
        edges.append(np.concatenate([[-layout.gap_mm], lines, [lines[-1] + layout.gap_mm]]))
    parts = TAG_CELLS + 1  # a gap and a tag
    white = np.ones((target.rows * parts + 1, target.columns * parts + 1))
    white[::parts, ::parts] = 0.0
    for (i, j), code in zip(layout.tag_places, layout.tag_codes, strict=True):
        tag = white[j * parts + 1 : (j + 1) * parts, i * parts + 1 : (i + 1) * parts]
        tag[:] = 0.0
        tag[BORDER_CELLS:-BORDER_CELLS, BORDER_CELLS:-BORDER_CELLS] = code
    return _sheet(edges[0], edges[1], white, quiet_zone * target.pitch_mm)


def _dots(target: TargetSpec, quiet_zone: float, origin_dot: float) -> DotPattern:
    """Return the dots, each `marker_mm` wide or half as wide as they stand apart."""
    staggered = target.kind == "asymmetric_circles"
    points = target.points_target()[:, :2]
    turn = np.array([[0.5, 0.5], [-0.5, 0.5]]) if staggered else np.eye(2)
    to_index = turn / target.pitch_mm
    apart = target.pitch_mm * (np.sqrt(2.0) if staggered else 1.0)
    index = np.rint(points @ to_index.T).astype(np.intp)
    first = index.min(axis=0)
    radius = np.zeros(tuple((index.max(axis=0) - first + 1)[::-1]))
    radius[index[:, 1] - first[1], index[:, 0] - first[0]] = 0.5 * (target.marker_mm or 0.5 * apart)
    radius[index[0, 1] - first[1], index[0, 0] - first[0]] *= origin_dot
    low, high = points.min(axis=0) - apart, points.max(axis=0) + apart
    blank = _sheet(
        np.array([low[0], high[0]]),
        np.array([low[1], high[1]]),
        np.ones((1, 1)),
        quiet_zone * target.pitch_mm,
    )
    return DotPattern(blank, to_index, (int(first[0]), int(first[1])), radius)


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
