"""Which size a chessboard is said to have where its ends are hidden, cut off or next to another board."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core.errors import OriginUnknown, TargetMismatch, TargetNotFound
from core.simulation import Scene
from core.targets import TargetSpec, detect
from core.targets.chessboard import detector
from core.targets.chessboard.detector import trace_detection
from core.targets.lattice import growing
from core.targets.lattice.corner_graph import Patches, link
from core.targets.lattice.saddle_points import Saddles
from tests.support.targets.corner_errors import LARGEST_ERROR_PX, worst
from tests.support.targets.drawn_boards import NINE_BY_SIX, drawn_board

Take = Callable[..., tuple[Scene, np.ndarray]]


@pytest.mark.parametrize("lines", [1, 2])
def test_a_hidden_end_is_no_smaller_board(take: Take, lines: int) -> None:
    """What hides the last columns leaves a lattice of the size asked for; its squares end unevenly or too early."""
    scene, image = take(14, 10, seed=2)
    grid = scene.points_px.reshape(10, 14, 2)
    last, step = grid[:, -lines], grid[:, -lines] - grid[:, -lines - 1]
    edge = last - step * np.linspace(0.9, 0.3, 10)[:, None]
    outline = np.concatenate([edge, [edge[-1] + 40 * step[-1], edge[0] + 40 * step[0]]])
    hidden = image.copy()
    cv2.fillPoly(hidden, [np.rint(outline).astype(np.int32)], 230)
    with pytest.raises((TargetNotFound, TargetMismatch)):
        detect(hidden, TargetSpec("chessboard", 14 - lines, 10, 20.0))


def side_by_side(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    return np.concatenate([left, right], axis=1)


def test_two_boards_in_view(take: Take) -> None:
    one, first = take(9, 6, seed=1)
    other, second = take(14, 10, seed=2)
    both = side_by_side(first, second)
    assert worst(detect(both, one.target), one) < LARGEST_ERROR_PX
    found = detect(both, other.target)
    moved = dataclasses.replace(found, points_px=found.points_px - (first.shape[1], 0.0))
    assert worst(moved, other) < LARGEST_ERROR_PX
    with pytest.raises(TargetMismatch, match="14 x 10 grid is in view, 8 x 6"):
        detect(both, TargetSpec("chessboard", 8, 6, 20.0))
    with pytest.raises(TargetMismatch, match="2 grids of 9 x 6"):
        detect(side_by_side(first, take(9, 6, seed=4)[1]), one.target)


def test_a_lattice_cut_short_is_no_smaller_board(monkeypatch: pytest.MonkeyPatch) -> None:
    """Growing ends at a limit: a lattice that goes on beyond it is never whole, at whatever line it stopped."""
    image = cv2.GaussianBlur(drawn_board(60, 40), (0, 0), 1.0)
    monkeypatch.setattr(growing, "MAX_LINES", 30)
    monkeypatch.setattr(detector, "link", fewer_links)
    trace = trace_detection(image, NINE_BY_SIX)
    boards = [board for step in trace.steps for board in step.boards]
    assert any(board.lattice.cut_short and board.size != (60, 40) for board in boards)
    for board in boards:
        assert not board.is_whole or board.size == (60, 40)
    with pytest.raises(TargetMismatch, match="at least"):
        detect(image, NINE_BY_SIX)


def fewer_links(saddles: Saddles) -> Patches:
    """Only what is linked within the image's upper left part, as if its corners alone had been kept."""
    patches = link(saddles)
    height, width = saddles.smooth.shape
    kept = (saddles.points[:, 0] < 0.3 * width) & (saddles.points[:, 1] < 0.3 * height)
    patch = np.where(kept & (patches.patch == 0), 0, -1)
    return dataclasses.replace(patches, patch=patch, sizes=np.array([np.count_nonzero(patch == 0)]))


@pytest.mark.parametrize("beyond_px", [-1, 1, 3])
def test_a_board_whose_corners_meet_the_edge_of_the_image_may_go_on(take: Take, beyond_px: int) -> None:
    """All of its corners may be in view, but nobody sees that it ends with them."""
    scene, image = take(9, 6, seed=1, max_roll_deg=0.0)
    end = round(float(scene.points_px[:, 0].max())) + beyond_px
    with pytest.raises((OriginUnknown, TargetNotFound)):
        detect(np.ascontiguousarray(image[:, :end]), scene.target)
    grid = scene.points_px.reshape(6, 9, 2)
    hidden = image.copy()
    last, step = grid[-1], grid[-1] - grid[-2]
    edge = last + step * np.linspace(0.8, 0.1, 9)[:, None]
    cv2.fillPoly(hidden, [np.rint(np.concatenate([edge, edge[::-1] + 30 * step])).astype(np.int32)], 230)
    with pytest.raises(TargetNotFound, match="outermost squares are cut off"):
        detect(np.ascontiguousarray(hidden[:, :end]), scene.target)


def test_hidden_outermost_squares_are_said_to_be(take: Take) -> None:
    scene, image = take(9, 6, seed=1)
    grid = scene.points_px.reshape(6, 9, 2)
    last, step = grid[:, -1], grid[:, -1] - grid[:, -2]
    edge = last + step * np.linspace(0.8, 0.1, 6)[:, None]
    hidden = image.copy()
    cv2.fillPoly(hidden, [np.rint(np.concatenate([edge, edge[::-1] + 30 * step])).astype(np.int32)], 230)
    with pytest.raises(TargetNotFound, match="outermost squares are hidden"):
        detect(hidden, scene.target)
