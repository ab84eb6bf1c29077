"""What to say where the chessboard asked for was not found: what the image shows instead."""

from __future__ import annotations

from collections.abc import Iterable

from core.errors import DetectionError, OriginUnknown, TargetMismatch, TargetNotFound
from core.targets.chessboard.partial_view import may_be_part
from core.targets.lattice import MIN_VISIBLE_SHARE, Board
from core.targets.specification import TargetSpec

MIN_SEEN_SHARE = 0.5
"""Of a board's corners."""


def fits(board: Board, target: TargetSpec) -> bool:
    """Return whether a board has the size asked for, either way round."""
    return board.size == (max(target.columns, target.rows), min(target.columns, target.rows))


def not_found(seen: Iterable[Board], target: TargetSpec) -> DetectionError:
    """Return the error for an image without the board; it states what was found instead."""
    asked = f"{target.columns} x {target.rows}"
    boards = [board for board in seen if board.lattice.known.mean() >= MIN_SEEN_SHARE]
    if not boards:
        return TargetNotFound(f"No chessboard of {asked} inner corners was found.")
    # A board on a screen or a sheet in the background may show more points than one of which a part is hidden; clutter
    # that looks like a few squares shows far fewer.
    most = max(int(b.lattice.known.sum()) for b in boards)
    near = [b for b in boards if b.is_resolved and 2 * b.lattice.known.sum() > most]
    board = max(near or boards, key=lambda b: int(b.lattice.known.sum()))
    long, short = board.size
    if not board.is_resolved:
        return TargetNotFound(
            f"A grid of about {long} x {short} is in view, but its squares are only {board.square_px:.0f} px wide.",
            "Move the camera nearer, or use a board with larger squares: 8 px and more.",
        )
    if any(side.is_crossed for side in board.sides):
        return TargetMismatch(
            f"{long} x {short} points of a larger grid are in view, {asked} were asked for: it goes on beyond "
            "something that lies across it.",
            "Take away what lies across the board, such as a cable or a ruler, and check columns and rows.",
        )
    if board.is_whole:
        return _another_size(board, target)
    if long > max(target.columns, target.rows) or short > min(target.columns, target.rows):
        return TargetMismatch(f"A grid of at least {long} x {short} is in view, {asked} was asked for.")
    if fits(board, target):
        return _not_whole(board, asked)
    if may_be_part(board, target):
        return OriginUnknown(
            f"Only {long} x {short} points of a grid are wholly in view, {asked} were asked for, and no marked squares "
            "determine which part of the board they are."
        )
    if board.continues:
        return TargetNotFound(
            f"Only {long} x {short} points of a grid are wholly in view, {asked} were asked for."
        )
    return TargetNotFound(
        f"{long} x {short} points of a grid are seen, but not where it ends; {asked} were asked for.",
        "Keep the outermost squares, and the margin around them, in view and free of reflections.",
    )


def _another_size(board: Board, target: TargetSpec) -> TargetMismatch:
    """Return what to say of a board that ends on all sides, and has another size than the one asked for."""
    long, short = board.size
    asked = sorted((target.columns, target.rows), reverse=True)
    detail = f"A {long} x {short} grid is in view, {target.columns} x {target.rows} was asked for."
    if long > asked[0] or short > asked[1] or not set(board.size) & set(asked):
        return TargetMismatch(detail)
    return TargetMismatch(
        detail,
        "Check columns and rows, which count inner corners; if they are right, take away what lies across the board "
        "and hides the rest; keep other grids out of view.",
    )


def _not_whole(board: Board, asked: str) -> TargetNotFound:
    """Return what to say where as many points as were asked for are seen, but not that the board ends with them."""
    seen = f"A grid of {asked} points is in view, but"
    if board.is_cropped or any(side.visible < MIN_VISIBLE_SHARE for side in board.sides):
        return TargetNotFound(
            f"{seen} its outermost squares are cut off by the image border.",
            "Move the camera or the board until all squares and some of the margin around them are in the image.",
        )
    if board.continues:
        return TargetNotFound(
            f"{seen} it seems to go on beyond them.",
            "Count the inner corners of the board, and keep other patterns away from its edge.",
        )
    return TargetNotFound(
        f"{seen} its outermost squares are hidden, or merge with something next to them.",
        "Keep the outermost squares, and the margin around them, in view and free of reflections.",
    )
