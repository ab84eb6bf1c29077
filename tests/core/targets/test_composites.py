"""Images with a second, smaller board: the one asked for is measured, whichever it is, or neither is."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core.errors import TargetMismatch
from core.simulation import Scene
from core.targets import TargetSpec, detect

Take = Callable[..., tuple[Scene, np.ndarray]]
Size = tuple[int, int]
GREY = 128


def board(size: Size) -> TargetSpec:
    return TargetSpec("chessboard", *size, 20.0)


def composite(image: np.ndarray, other: np.ndarray, scale: float) -> np.ndarray:
    """Return an image with another one to its right, made smaller."""
    small = cv2.resize(other, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    whole = np.full((image.shape[0], image.shape[1] + small.shape[1]), GREY, np.uint8)
    whole[:, : image.shape[1]] = image
    whole[: small.shape[0], image.shape[1] :] = small
    return whole


@pytest.mark.parametrize("scale", [0.25, 0.4])
@pytest.mark.parametrize(("large", "small"), [((11, 8), (9, 6)), ((9, 6), (7, 5)), ((11, 8), (7, 5))])
def test_each_board_is_found_where_it_is_and_no_third_one(
    take: Take, large: Size, small: Size, scale: float
) -> None:
    scene, image = take(*large, seed=1)
    other_scene, other = take(*small, seed=51, tilt_deg=10.0, max_roll_deg=10.0)
    whole = composite(image, other, scale)
    # A pixel's middle has whole coordinates: what is made smaller moves by half a pixel less half a smaller one.
    moved = (other_scene.points_px + 0.5) * scale - 0.5 + [image.shape[1], 0.0]
    for asked, truth, near in ((large, scene.points_px, 0.1), (small, moved, 0.3)):
        found = detect(whole, board(asked)).points_px
        distances = np.linalg.norm(found[:, None] - truth[None], axis=2).min(axis=1)
        assert len(found) == len(truth)
        assert float(distances.max()) < near
    for absent in {(9, 6), (7, 5), (11, 8), (8, 6)} - {large, small}:
        with pytest.raises(TargetMismatch):
            detect(whole, board(absent))


@pytest.mark.parametrize("seed", range(3))
def test_two_boards_of_the_size_asked_for_are_one_too_many(take: Take, seed: int) -> None:
    _, image = take(9, 6, seed=seed)
    _, other = take(9, 6, seed=seed + 50, tilt_deg=10.0, max_roll_deg=10.0)
    with pytest.raises(TargetMismatch, match="2 grids of 9 x 6"):
        detect(composite(image, other, 0.4), board((9, 6)))
