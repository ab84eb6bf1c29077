"""Chessboards of random poses, small ones too: found, named by their size, and not found in clutter."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
import pytest

from core.errors import TargetMismatch, TargetNotFound
from core.simulation import Scene
from core.simulation.background import background
from core.targets import TargetSpec, detect
from tests.support.simulation.renders import render
from tests.support.simulation.scenes import standard_scene, standard_target
from tests.support.targets.corner_errors import LARGEST_ERROR_PX, worst

BOARDS = [(9, 6), (14, 10), (25, 18)]
FACTORS = [0.4, 0.6, 0.8]
OTHERS = [(8, 6), (9, 7), (10, 6), (9, 5), (13, 10), (14, 9), (15, 10), (24, 18), (25, 17)]


def assert_all_found(scenes: Iterable[Scene]) -> None:
    """Every board, nearly every corner of it, none in a wrong place."""
    for scene in scenes:
        found = detect(render(scene), scene.target)
        assert worst(found, scene) < LARGEST_ERROR_PX, scene.seed
        assert len(found) >= 0.97 * scene.target.size, scene.seed


def shrunk(scene: Scene, factor: float) -> Scene:
    """The same view by a camera of fewer pixels, its first pixel's corner in the same place."""
    c = scene.camera
    camera = dataclasses.replace(
        c,
        fx_px=factor * c.fx_px,
        fy_px=factor * c.fy_px,
        cx_px=factor * (c.cx_px + 0.5) - 0.5,
        cy_px=factor * (c.cy_px + 0.5) - 0.5,
    )
    width, height = (round(factor * side) for side in (scene.width_px, scene.height_px))
    return dataclasses.replace(scene, camera=camera, width_px=width, height_px=height)


@pytest.mark.parametrize(("size", "factor"), list(zip(BOARDS, FACTORS, strict=True)))
@pytest.mark.parametrize(
    "seeds", [range(1), pytest.param(range(1, 13), marks=pytest.mark.slow)], ids=["sample", "all"]
)
def test_boards_of_random_poses_are_found(size: tuple[int, int], factor: float, seeds: range) -> None:
    """Tilts from 0 to 60°: all of 36, so that fewer than one in 12 is missed (95 %); 306 in `make bench`.

    Fewer pixels where squares are large, which render sooner.
    """
    scenes = (standard_scene(standard_target(*size), 90_000 + seed) for seed in seeds)
    assert_all_found(shrunk(scene, factor) for scene in scenes)


@pytest.mark.parametrize(
    "seeds", [range(1), pytest.param(range(1, 30), marks=pytest.mark.slow)], ids=["sample", "all"]
)
def test_none_is_found_in_clutter(seeds: range) -> None:
    for seed in seeds:
        scene = standard_scene(standard_target(9, 6), 95_000 + seed)
        shape = (scene.height_px, scene.width_px)
        noise = np.float32(4.0) * np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)
        image = np.clip(background(scene) + noise, 0, 255).astype(np.uint8)
        for asked in BOARDS:
            with pytest.raises(TargetNotFound):
                detect(image, TargetSpec("chessboard", *asked, 20.0))


@pytest.mark.parametrize(
    "numbers",
    [(0,), pytest.param(range(1, 9), marks=pytest.mark.slow)],
    ids=["sample", "all"],
)
def test_another_board_is_named_by_its_size(numbers: Iterable[int]) -> None:
    for number in numbers:
        columns, rows = OTHERS[number]
        scene = shrunk(standard_scene(standard_target(columns, rows), 96_000 + number), 0.6)
        image = render(scene)
        for asked in BOARDS:
            with pytest.raises(TargetMismatch, match=f"{columns} x {rows} grid"):
                detect(image, TargetSpec("chessboard", *asked, 20.0))
