"""What is printed: the sheet as cells between straight lines, each with its ink."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import InvalidTarget
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
        This kind cannot be rendered.
    """
    if target.kind == "chessboard":
        return _chessboard(target, quiet_zone)
    raise InvalidTarget(f"A target of kind {target.kind!r} cannot be rendered.")


def _chessboard(target: TargetSpec, quiet_zone: float) -> RectilinearPattern:
    """Return (columns + 1) x (rows + 1) squares; the one beyond grid point (0, 0) is black, as are all whose
    indices from there have an even sum."""
    margin = max(quiet_zone, 0.0)
    edges = [
        np.concatenate([[-1.0 - margin], np.arange(-1.0, count + 1.0), [count + margin]]) * target.pitch_mm
        for count in (target.columns, target.rows)
    ]
    j, i = np.mgrid[0 : target.rows + 1, 0 : target.columns + 1]
    white = np.pad(np.pad(((i + j) % 2).astype(np.float64), 1, constant_values=1.0), 1)
    sheet = np.pad(np.ones((target.rows + 3, target.columns + 3)), 1)
    return RectilinearPattern(edges[0], edges[1], white, sheet)
