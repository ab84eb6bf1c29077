"""Names for grid points that a picture by itself leaves open, from another picture of the same pose.

A part of a chessboard may be any part, and a board that looks the same when turned was read one way or another. Images
of one pose of the robot show the grid at the same pixels but for its repeatability, far less than half a square. So the
points take the names that points of a reference image have at the same pixels.

For a part, each of its points that lies within a quarter of the reference's shortest step of a reference point says by
which shift of columns and rows it would be that point, for each of four quarter turns of the part's own count. The turn
and shift most of them agree on is the answer, if these are most of the part's points. By any other shift or turn the
points would lie at least three quarters of a step from those whose names they took, three times as far as they may.
Staggered grids are turned and shifted on their lines (`core.targets.dot_sites`).
That holds for images of one pose. A board that stood whole squares aside, as after a pose that was taught anew or under
the wrong label, shows the same pattern at the same pixels. Three things speak against it, each enough for a refusal:

- Other images of the pose show the points of one name elsewhere than the reference (`stands_with`).
- The part's colours: its detector counts it so that square (i, j) is black where i + j is even, as on a whole board.
- The part's ends: a detector calls a grid a part only where each side is an end of the board or leaves the picture
  (`core.targets.partial_board`, `core.targets.partial_dots`). A naming by which the next line would lie clear of the
  picture's border puts an end of the board in its midst.

A board that stood an even number of squares aside goes unnoticed only where no end of it is in view the way it moved.

For a whole board the turns that leave the grid what it is are compared by the distance between points of one name.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.readings import quarter_turns, turned_cells
from core.targets.dot_sites import apart, cells_of, is_staggered, lines, sites_of
from core.targets.specification import GridPoints

NEAR = 0.25
"""Of the reference's shortest step: how far a point may lie from the one whose name it takes."""
CLEAR = 0.5
"""Of the distance by the next best reading: the best one's, for it to be clear."""
ALIKE = 0.9
"""Of the points that two images have in common: as many must be near each other for the images to agree."""
CLEAR_OF_BORDER = 0.75
"""Of a step: a line of points so far from the border is found; half a step is enough, `NEAR` is the pose's scatter."""
MOST_IN_VIEW = 0.5
"""Of the places next to a side's points: with more of them in view a detector finds the line, or the board ends."""
QUARTER_TURNS = np.array(
    [[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]], dtype=np.intp
)


@dataclass(frozen=True, slots=True)
class Named:
    """The columns and rows of a view's points by the reference's reading, and whether they are others than before."""

    column: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    changed: bool


Unnamed = Literal["unlike", "aside"]
"""Why a view is not named: its pixels do not tell it clearly (images of different poses, or with too little in common);
or they tell names that the part's colours or ends contradict, so that its board stood squares aside."""


def name_points(view: GridPoints, reference: GridPoints) -> Named | Unnamed:
    """Name the points of a view as `reference`, a picture of the same pose, target and size, has them, or say why not.

    `view.origin` says what is open: of "unknown" parts the turn and the shift, of "turned" boards the turn alone.
    """
    if view.origin == "known":
        return Named(view.column, view.row, changed=False)
    if not len(view) or not len(reference):
        return "unlike"
    found = _part(view, reference) if view.origin == "unknown" else _turned(view, reference)
    if isinstance(found, str):
        return found
    column, row = found
    changed = not (np.array_equal(column, view.column) and np.array_equal(row, view.row))
    return Named(column, row, changed)


def stands_with(view: GridPoints, reference: GridPoints) -> bool:
    """Tell whether two named pictures show the grid at one place: points of one name within a quarter of a step."""
    away = np.linalg.norm(view.points_px - _grid_px(reference)[view.row, view.column], axis=1)
    common = away[np.isfinite(away)]
    if 2 * len(common) <= min(len(view), len(reference)):
        return False
    return bool(np.mean(common <= NEAR * _shortest_step(reference)) >= ALIKE)


def _part(
    view: GridPoints, reference: GridPoints
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]] | Unnamed:
    step = _shortest_step(reference)
    away = np.linalg.norm(view.points_px[:, None] - reference.points_px, axis=2)
    nearest = np.argmin(away, axis=1)
    near = away[np.arange(len(view)), nearest] <= NEAR * step
    if 2 * int(near.sum()) <= len(view):
        return "unlike"
    own = sites_of(view.target, view.column, view.row)
    told = sites_of(view.target, reference.column, reference.row)[nearest[near]]
    quarters, shift, agreeing = 0, np.zeros(2, dtype=np.intp), 0
    for k, turn in enumerate(QUARTER_TURNS):
        shifts, counts = np.unique(told - own[near] @ turn.T, axis=0, return_counts=True)
        most = int(np.argmax(counts))
        if counts[most] > agreeing:
            quarters, shift, agreeing = k, shifts[most], int(counts[most])
    if 2 * agreeing <= len(view):
        return "unlike"
    column, row = cells_of(view.target, own @ QUARTER_TURNS[quarters].T + shift)
    # The square after (0, 0) comes to lie diagonally before it, beside it, or above it: a quarter turn moves it by one.
    other_colours = view.target.kind == "chessboard" and (int(shift.sum()) + quarters) % 2 != 0
    if other_colours or not np.all(_inside(view, column, row)) or _ends_amidst(view, reference, column, row):
        return "aside"
    return column, row


def _ends_amidst(
    view: GridPoints,
    reference: GridPoints,
    column: Int[np.ndarray, " n"],
    row: Int[np.ndarray, " n"],
) -> bool:
    """Tell whether a part, so named, ends within the picture where the reference has another line of points."""
    grid = _lines_px(reference)
    shown = np.zeros(grid.shape[:2], dtype=np.bool_)
    x, y = sites_of(view.target, column, row).T
    shown[y, x] = True
    last = np.array([view.image_width_px, view.image_height_px]) - 1.0
    for k in range(4):  # each side in turn as the first column
        px, there = np.rot90(grid, k), np.rot90(shown, k)
        first = int(np.argmax(there.any(axis=0)))
        if first == 0:
            continue
        inner, beyond = px[there[:, first], first], px[there[:, first], first - 1]
        clear = beyond + CLEAR_OF_BORDER * apart(view.target) * (beyond - inner)
        in_view = np.all((clear > 0.0) & (clear < last), axis=1)
        if in_view.mean() > MOST_IN_VIEW:
            return True
    return False


def _turned(
    view: GridPoints, reference: GridPoints
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]] | Unnamed:
    grid = _grid_px(reference)
    readings: list[tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]] = []
    distances = []
    for quarters in quarter_turns(view.target):
        column, row = turned_cells(view.target, view.column, view.row, quarters)
        away = np.linalg.norm(view.points_px - grid[row, column], axis=1)
        seen = np.isfinite(away)
        if 2 * int(seen.sum()) <= len(view):
            return "unlike"
        readings.append((column, row))
        distances.append(float(away[seen].mean()))
    order = np.argsort(distances)
    if len(order) > 1 and distances[order[0]] > CLEAR * distances[order[1]]:
        return "unlike"
    return readings[int(order[0])]


def _inside(
    view: GridPoints, column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    target = view.target
    return np.asarray((column >= 0) & (column < target.columns) & (row >= 0) & (row < target.rows))


def _grid_px(points: GridPoints) -> Float[np.ndarray, "rows columns 2"]:
    """Return points by their names, NaN where there are none."""
    grid = np.full((points.target.rows, points.target.columns, 2), np.nan)
    grid[points.row, points.column] = points.points_px
    return grid


def _lines_px(points: GridPoints) -> Float[np.ndarray, "down across 2"]:
    """Return points by their lines; on staggered grids the places between them lie midway of those beside, or else of
    those above and below."""
    if not is_staggered(points.target):
        return _grid_px(points)
    across, down = lines(points.target)
    grid = np.full((down + 2, across + 2, 2), np.nan)
    x, y = sites_of(points.target, points.column, points.row).T
    grid[y + 1, x + 1] = points.points_px
    beside, over = 0.5 * (grid[1:-1, :-2] + grid[1:-1, 2:]), 0.5 * (grid[:-2, 1:-1] + grid[2:, 1:-1])
    midway = np.where(np.isfinite(beside), beside, over)
    return np.where(np.isfinite(grid[1:-1, 1:-1]), grid[1:-1, 1:-1], midway)


def _shortest_step(reference: GridPoints) -> float:
    """Return the median distance (px) of neighbours, along rows, columns or diagonals, whichever is least."""
    grid = _grid_px(reference)
    steps = (
        grid[:, 1:] - grid[:, :-1],
        grid[1:] - grid[:-1],
        grid[1:, 1:] - grid[:-1, :-1],
        grid[1:, :-1] - grid[:-1, 1:],
    )
    lengths = [np.linalg.norm(step, axis=2) for step in steps]
    medians = [np.median(length[np.isfinite(length)]) for length in lengths if np.isfinite(length).any()]
    return float(np.min(medians)) if medians else 0.0
