"""Names for grid points that a picture by itself leaves open, from another picture of the same pose.

A part of a chessboard may be any part, and a board that looks the same when turned was read one way or another. Images
of one pose of the robot show the grid at the same pixels but for its repeatability, far less than half a square. So the
points take the names that points of a reference image have at the same pixels.

For a part, each of its points that lies within a quarter of the reference's shortest step of a reference point says by
which shift of columns and rows it would be that point, for each of four quarter turns of the part's own count. The turn
and shift most of them agree on is the answer, if these are most of the part's points. By any other shift or turn the
points would lie at least three quarters of a step from those whose names they took, three times as far as they may.
That holds for images of one pose. A board that stood whole squares aside, as after a pose that was taught anew or under
the wrong label, shows the same pattern at the same pixels, and nothing in a part tells: its names are then wrong.

For a whole board the turns that leave the grid what it is are compared by the distance between points of one name.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from core.calibration.readings import quarter_turns, turned_cells
from core.targets.specification import GridPoints

NEAR = 0.25
"""Of the reference's shortest step: how far a point may lie from the one whose name it takes."""
CLEAR = 0.5
"""Of the distance by the next best reading: the best one's, for it to be clear."""
QUARTER_TURNS = np.array(
    [[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]], dtype=np.intp
)


@dataclass(frozen=True, slots=True)
class Named:
    """The columns and rows of a view's points by the reference's reading, and whether they are others than before."""

    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    changed: bool


def name_points(view: GridPoints, reference: GridPoints) -> Named | None:
    """Name the points of a view as `reference`, a picture of the same pose and target, has them.

    `view.origin` says what is open: of "unknown" parts the turn and the shift, of "turned" boards the turn alone.
    Returns None where the pixels do not tell it clearly: images of different poses, or with too little in common.
    """
    if view.origin == "known":
        return Named(view.column, view.row, changed=False)
    if not len(view) or not len(reference):
        return None
    found = _part(view, reference) if view.origin == "unknown" else _turned(view, reference)
    if found is None:
        return None
    column, row = found
    changed = not (np.array_equal(column, view.column) and np.array_equal(row, view.row))
    return Named(column, row, changed)


def _part(
    view: GridPoints, reference: GridPoints
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]] | None:
    step = _shortest_step(reference)
    away = np.linalg.norm(view.points_px[:, None] - reference.points_px, axis=2)
    nearest = np.argmin(away, axis=1)
    near = away[np.arange(len(view)), nearest] <= NEAR * step
    if 2 * int(near.sum()) <= len(view):
        return None
    own = np.stack([view.column, view.row], axis=1)
    told = np.stack([reference.column, reference.row], axis=1)[nearest[near]]
    best, agreeing = None, 0
    for turn in QUARTER_TURNS:
        shifts, counts = np.unique(told - own[near] @ turn.T, axis=0, return_counts=True)
        most = int(np.argmax(counts))
        if counts[most] > agreeing:
            best, agreeing = own @ turn.T + shifts[most], int(counts[most])
    if best is None or 2 * agreeing <= len(view):
        return None
    column, row = np.ascontiguousarray(best[:, 0]), np.ascontiguousarray(best[:, 1])
    return (column, row) if bool(np.all(_inside(view, column, row))) else None


def _turned(
    view: GridPoints, reference: GridPoints
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]] | None:
    grid = np.full((view.target.rows, view.target.columns, 2), np.nan)
    grid[reference.row, reference.column] = reference.points_px
    readings: list[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]] = []
    distances = []
    for quarters in quarter_turns(view.target):
        column, row = turned_cells(view.target, view.column, view.row, quarters)
        away = np.linalg.norm(view.points_px - grid[row, column], axis=1)
        seen = np.isfinite(away)
        if 2 * int(seen.sum()) <= len(view):
            return None
        readings.append((column, row))
        distances.append(float(away[seen].mean()))
    order = np.argsort(distances)
    if len(order) > 1 and distances[order[0]] > CLEAR * distances[order[1]]:
        return None
    return readings[int(order[0])]


def _inside(
    view: GridPoints, column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    target = view.target
    return np.asarray((column >= 0) & (column < target.columns) & (row >= 0) & (row < target.rows))


def _shortest_step(reference: GridPoints) -> float:
    """Return the median distance (px) of neighbours, along rows, columns or diagonals, whichever is least."""
    grid = np.full((reference.target.rows, reference.target.columns, 2), np.nan)
    grid[reference.row, reference.column] = reference.points_px
    steps = (
        grid[:, 1:] - grid[:, :-1],
        grid[1:] - grid[:-1],
        grid[1:, 1:] - grid[:-1, :-1],
        grid[1:, :-1] - grid[:-1, 1:],
    )
    lengths = [np.linalg.norm(step, axis=2) for step in steps]
    medians = [np.median(length[np.isfinite(length)]) for length in lengths if np.isfinite(length).any()]
    return float(np.min(medians)) if medians else 0.0
