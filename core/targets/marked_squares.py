"""Chessboards that carry marks, so that a part of one tells which part it is.

Four squares near the board's middle carry a round dot of the opposite colour, in the shape of an L: the elbow, a white
square with a black dot; two more along +x from it; one along +y. Seen from the front, with x to the right and y down
(`#` black square, `.` white one, `o` white dot, `x` black dot):

    . # . # . #
    # x o x # .      the elbow, and two squares to its right
    . o . # . #      one below it
    # . # . # .

No turn makes this L the same again, and no mirror makes it a turned one: one look tells origin, turn and mirroring,
whatever else of the board is in view. The square (i, j) is that between the grid points (i, j) and (i + 1, j + 1); the
square diagonally beyond grid point (0, 0) is black, so white squares are those with i + j odd. A dot is .34 pitches
wide, as OpenCV's `gen_pattern.py` draws its markers: its edge stays a third of a pitch away from the edges that corners
are measured by.
"""

from __future__ import annotations

from core.targets.specification import TargetSpec

MARK_DIAMETER = 0.34
"""Of the pitch."""
SHAPE = ((0, 0), (1, 0), (2, 0), (0, 1))
"""The marked squares, counted from the elbow."""


def marked_squares(target: TargetSpec) -> tuple[tuple[int, int], ...]:
    """Return the squares (i, j) of a chessboard that carry a mark if any do, the elbow first.

    Square (i, j) lies between the grid points (i, j) and (i + 1, j + 1). Empty for what is no chessboard, and for
    boards of less than 4 x 4 or 5 x 3 grid points, on which the marks have no room.
    """
    if target.kind != "chessboard":
        return ()
    places = [(a, b) for b in range(target.rows - 2) for a in range(target.columns - 3) if (a + b) % 2 == 1]
    if not places:
        return ()
    middle = (0.5 * (target.columns - 4), 0.5 * (target.rows - 3))
    elbow = min(places, key=lambda p: (abs(p[0] - middle[0]) + abs(p[1] - middle[1]), p))
    return tuple((elbow[0] + i, elbow[1] + j) for i, j in SHAPE)


def mark_diameter_mm(target: TargetSpec) -> float:
    """Return how wide a mark's dot is, mm."""
    return MARK_DIAMETER * target.pitch_mm
