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
    """An ellipse is fitted to what the border leaves of them, and is off."""
    scene = replace(scene_of(spec, 10.0, seed=6), noise_levels=2.0)
    places = scene.points_px
    begin = int(np.sort(places[:, 0])[1]) + left_px
    found = detect(np.ascontiguousarray(render(scene)[:, begin:]), spec)
    truth = places[found.row * spec.columns + found.column] - [begin, 0.0]
    assert truth[:, 0].min() > 15.0  # dots of 18 px and more
    assert np.all(np.abs(found.points_px - truth).max(axis=1) < 4.0 * found.standard_uncertainty_px)
    assert len(found) > 0.9 * np.count_nonzero(places[:, 0] > begin)


@pytest.mark.parametrize("roll", [0.0, 0.06])
def test_a_board_whose_outer_rows_are_cut_is_refused(roll: float) -> None:
    """By its middle row it has no place in the plane, nor by that and one dot of another, which roll leaves whole."""
    board = TargetSpec("circles", 9, 3, 25.0)
    scene = replace(scene_of(board, 5.0, seed=6, roll=roll), noise_levels=2.0, clutter=0.0)
    image, rows = render(scene), scene.points_px.reshape(3, 9, 2)[:, :, 1]
    top, bottom = sorted((float(rows[0].mean()), float(rows[2].mean())))
    for less in (-16, -8, -4, 0, 8):
        part = np.ascontiguousarray(image[round(top) + less : round(bottom) - less])
        with pytest.raises((TargetNotFound, OriginUnknown)):
            detect(part, board)


@pytest.mark.parametrize("spec", [SYMMETRIC, ASYMMETRIC])
@pytest.mark.parametrize("share", [0.1, 0.2])
def test_dots_that_a_sheet_covers_along_an_edge_are_not_measured(spec: TargetSpec, share: float) -> None:
    """Ellipses are fitted to the rest as well as to whole dots, in noise; off by half of what is covered, they draw the
    map at the end of the board that they are judged by."""
    scene = replace(scene_of(spec, 25.0, seed=6), noise_levels=0.0)
    image = render(scene)
    places = scene.points_px.reshape(spec.rows, spec.columns, 2)
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    for place, inward in zip(places[1:-1, -1], places[1:-1, -2], strict=True):
        out = (place - inward) / np.linalg.norm(place - inward)
        ray = [image[tuple(np.rint(place + k * out)[::-1].astype(int))] for k in range(30)]
        radius = int(np.argmax(np.array(ray) > 100))
        beyond = (u - place[0]) * out[0] + (v - place[1]) * out[1]
        near = np.hypot(u - place[0], v - place[1]) < 1.3 * radius
        image[near & (beyond > (1.0 - 2.0 * share) * radius)] = ray[radius + 4]
    blurred = cv2.GaussianBlur(image.astype(np.float64), (0, 0), 2.0)
    noise = 10.0 * np.random.default_rng(1).standard_normal(image.shape)
    found = detect(np.clip(np.rint(blurred + noise), 0, 255).astype(np.uint8), spec)
    assert np.count_nonzero(found.column < spec.columns - 1) >= 0.95 * (spec.size - spec.rows)
    off = np.abs(errors(scene, found)).max(axis=1)
    assert np.all(off < 6.0 * found.standard_uncertainty_px)


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
