"""Boards of dots of which a part is in view: named by the larger dot, rejected without it; covered dots."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.errors import OriginUnknown, TargetMismatch, TargetNotFound
from core.simulation import Light, Scene
from core.targets import TargetSpec, detect
from tests.support.simulation.renders import render
from tests.support.targets.dot_scenes import ASYMMETRIC, SYMMETRIC, errors, scene_of


def test_covered_dots_are_missing_and_the_others_stay() -> None:
    scene = replace(scene_of(SYMMETRIC, 20.0, seed=6), noise_levels=2.0)
    image = render(scene)
    middle = scene.points_px.reshape(7, 9, 2)[3, 4]
    u, v = (round(float(c)) for c in middle)
    cv2.line(image, (u - 120, v - 100), (u + 120, v + 100), 90, 25)  # a cable
    found = detect(image, SYMMETRIC)
    assert 0.75 * SYMMETRIC.size <= len(found) < SYMMETRIC.size
    assert "points_missing" in [w.code for w in found.warnings]
    error = np.abs(errors(scene, found)).max(axis=1)
    assert np.quantile(error, 0.9) < 0.03
    assert np.all(error < 8.0 * found.standard_uncertainty_px)


@pytest.mark.parametrize("left_px", [-4, 0, 4])
@pytest.mark.parametrize("spec", [SYMMETRIC, ASYMMETRIC])
def test_dots_that_the_image_border_cuts_are_not_measured(spec: TargetSpec, left_px: int) -> None:
    """Under dirt and JPEG their ellipses are off by many times what is stated, and so is what they do to the map."""
    scene = replace(scene_of(spec, 10.0, seed=6), noise_levels=2.0)
    places = scene.points_px
    begin = int(np.sort(places[:, 0])[1]) + left_px
    found = detect(np.ascontiguousarray(render(scene)[:, begin:]), spec)
    truth = places[found.row * spec.columns + found.column] - [begin, 0.0]
    assert truth[:, 0].min() > 15.0  # dots of 18 px and more
    assert np.all(np.abs(found.points_px - truth).max(axis=1) < 4.0 * found.standard_uncertainty_px)
    assert len(found) > 0.9 * np.count_nonzero(places[:, 0] > begin)


def test_a_board_whose_outer_rows_are_cut_is_refused() -> None:
    board = TargetSpec("circles", 9, 3, 25.0)
    scene = replace(scene_of(board, 5.0, seed=6, roll=0.0), noise_levels=2.0, clutter=0.0)
    rows = scene.points_px.reshape(3, 9, 2)[:, :, 1]
    top, bottom = sorted((float(rows[0].mean()), float(rows[2].mean())))
    image = np.ascontiguousarray(render(scene)[round(top) - 4 : round(bottom) + 4])
    with pytest.raises(TargetNotFound, match="too poor"):
        detect(image, board)


WINDOWS = {
    "right": (-9.0, -9.0, 0.75, 9.0),
    "bottom": (-9.0, -9.0, 9.0, 0.75),
    "right and bottom": (-9.0, -9.0, 0.75, 0.75),
}


def cut(image: np.ndarray, scene: Scene, shares: tuple[float, ...]) -> tuple[np.ndarray, tuple[int, int]]:
    """A part of the image, its borders as shares of the grid points' bounding box; and where it begins."""
    low, high = scene.points_px.min(axis=0), scene.points_px.max(axis=0)
    edges = np.concatenate([low + shares[:2] * (high - low), low + shares[2:] * (high - low)])
    x0, y0, x1, y1 = (max(round(float(edge)), 0) for edge in edges)
    return np.ascontiguousarray(image[y0:y1, x0:x1]), (x0, y0)


@pytest.mark.parametrize("where", WINDOWS)
@pytest.mark.parametrize("is_bright", [False, True])
def test_a_part_with_the_larger_dot_is_named(where: str, is_bright: bool) -> None:
    light = Light(black_level=200.0, white_level=40.0) if is_bright else Light()
    for target in (SYMMETRIC, TargetSpec("circles", 8, 8, 25.0)):
        scene = replace(
            scene_of(target, 20.0, seed=8, roll=0.3), origin_dot=1.5, noise_levels=2.0, light=light
        )
        image, begin = cut(render(scene), scene, WINDOWS[where])
        found = detect(image, target)
        assert found.labelling == "absolute"
        assert [w.code for w in found.warnings] == ["points_missing"]
        assert 0.4 * target.size < len(found) < target.size
        truth = scene.points_px.reshape(target.rows, target.columns, 2)[found.row, found.column]
        off = np.abs(found.points_px + begin - truth).max(axis=1)
        assert np.median(off) < 0.02
        assert np.all(off < 6.0 * found.standard_uncertainty_px)  # some dots are cut in two


@pytest.mark.parametrize("where", WINDOWS)
def test_a_part_without_the_larger_dot_is_rejected(where: str) -> None:
    """Of staggered dots too, which have no larger one.

    Less is in view than of parts with a larger dot: at three quarters half of the outermost staggered line remains,
    which is enough for a whole board.
    """
    shares = tuple(0.7 if share == 0.75 else share for share in WINDOWS[where])
    for target in (SYMMETRIC, replace(ASYMMETRIC, columns=6)):
        scene = replace(scene_of(target, 20.0, seed=9, roll=1.5), noise_levels=2.0)
        image, _ = cut(render(scene), scene, shares)
        with pytest.raises(OriginUnknown):
            detect(image, target)


def test_a_part_that_cannot_be_of_the_board_is_rejected() -> None:
    scene = replace(scene_of(SYMMETRIC, 15.0, seed=9, roll=0.2), noise_levels=2.0)
    image, _ = cut(render(scene), scene, WINDOWS["right"])  # seven dots from end to end
    for asked in ((9, 8), (12, 10), (6, 5)):
        with pytest.raises((TargetNotFound, TargetMismatch)):
            detect(image, TargetSpec("circles", *asked, 25.0))
