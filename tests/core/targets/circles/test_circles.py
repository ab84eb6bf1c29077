"""Boards of dots: their centres against rendered truth, which dot is the origin, and what is not such a board."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.errors import TargetMirrored, TargetMismatch, TargetNotFound
from core.simulation import Light, Scene
from core.targets import GridPoints, TargetSpec, detect
from tests.support.simulation.renders import render
from tests.support.simulation.scenes import standard_scene, standard_target
from tests.support.targets.dot_scenes import ASYMMETRIC, SIZE, SYMMETRIC, errors, scene_of


@pytest.mark.parametrize("target", [SYMMETRIC, ASYMMETRIC], ids=["circles", "asymmetric"])
@pytest.mark.parametrize("tilt_deg", [0.0, 25.0, 45.0])
def test_centres_are_those_of_the_dots_not_of_their_images(target: TargetSpec, tilt_deg: float) -> None:
    """Without noise, under perspective and a lens with k1 -.2. Left alone, the images' own centres are off by up to
    half a pixel."""
    scene = scene_of(target, tilt_deg, seed=1)
    found = detect(render(scene), target)
    assert len(found) >= target.size - 1
    error = errors(scene, found)
    assert np.abs(error).max() < 0.005
    assert np.abs(error.mean(axis=0)).max() < 0.001


@pytest.mark.parametrize("seed", range(3))
def test_errors_are_as_stated(seed: int) -> None:
    scene = replace(scene_of(SYMMETRIC, 15.0 * seed + 10.0, seed), noise_levels=4.0)
    found = detect(render(scene), SYMMETRIC)
    assert len(found) == SYMMETRIC.size
    z = errors(scene, found) / found.standard_uncertainty_px[:, None]
    # of 126 coordinates the rms scatters by 1 / sqrt(252) = .063
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.2)
    assert np.median(found.standard_uncertainty_px) < 0.02


@pytest.mark.parametrize("target", [SYMMETRIC, ASYMMETRIC], ids=["circles", "asymmetric"])
@pytest.mark.parametrize("threshold", [90, 130])
def test_thresholded_dots_are_uncertain_by_their_pixels(target: TargetSpec, threshold: int) -> None:
    z = []
    for seed in range(60, 64):
        scene = scene_of(target, 10.0 * (seed - 60) + 5.0, seed)
        image = np.where(render(replace(scene, noise_levels=2.0)) > threshold, 255, 0).astype(np.uint8)
        found = detect(image, target)
        assert len(found) >= 0.9 * target.size
        assert np.median(found.standard_uncertainty_px) > 0.02
        z.append(errors(scene, found) / found.standard_uncertainty_px[:, None])
    assert 0.5 < np.sqrt(np.mean(np.concatenate(z) ** 2)) < 1.2


def test_bright_dots_on_a_dark_sheet() -> None:
    scene = replace(
        scene_of(SYMMETRIC, 20.0, seed=4), light=Light(black_level=200.0, white_level=40.0), noise_levels=2.0
    )
    found = detect(render(scene), SYMMETRIC)
    assert len(found) == SYMMETRIC.size
    assert np.abs(errors(scene, found)).max() < 0.05


@pytest.mark.parametrize("turns", range(4))
def test_a_larger_dot_is_the_origin(turns: int) -> None:
    """Whichever way the camera is turned, and on a board with as many columns as rows."""
    target = TargetSpec("circles", 7, 7, 25.0)
    scene = replace(scene_of(target, 15.0, seed=2, roll=0.2), origin_dot=1.5, noise_levels=2.0)
    found = detect(np.ascontiguousarray(np.rot90(render(scene), turns)), target)
    assert not found.warnings
    truth = scene.points_px.reshape(7, 7, 2)[found.row, found.column]
    off = np.abs(unturned(found.points_px, turns) - truth)
    assert off.max() < 0.05


def unturned(points: np.ndarray, turns: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Pixels of an image that numpy turned by quarter turns, as pixels of the one before."""
    width, height = size
    u, v = points.T
    return {
        0: np.stack([u, v], axis=1),
        1: np.stack([width - 1.0 - v, u], axis=1),
        2: np.stack([width - 1.0 - u, height - 1.0 - v], axis=1),
        3: np.stack([v, height - 1.0 - u], axis=1),
    }[turns]


def test_boards_that_look_the_same_when_turned_are_said_to() -> None:
    for target, ambiguous in ((SYMMETRIC, True), (ASYMMETRIC, False), (replace(ASYMMETRIC, rows=10), True)):
        image = render(scene_of(target, 20.0, seed=3, roll=0.2))
        found = detect(image, target)
        assert [w.code for w in found.warnings] == (["board_symmetry_unresolved"] if ambiguous else [])


def test_an_asymmetric_board_upside_down_keeps_its_origin() -> None:
    scene = scene_of(ASYMMETRIC, 20.0, seed=5, roll=0.2)
    found = detect(np.ascontiguousarray(np.rot90(render(scene), 2)), ASYMMETRIC)
    truth = scene.points_px.reshape(11, 4, 2)[found.row, found.column]
    assert np.abs(unturned(found.points_px, 2) - truth).max() < 0.01


def test_another_grid_is_named() -> None:
    image = render(replace(scene_of(SYMMETRIC, 10.0, seed=7), clutter=0.0))
    with pytest.raises(TargetMismatch, match="9 x 7 dots is in view, 8 x 5 was asked for"):
        detect(image, TargetSpec("circles", 8, 5, 25.0))
    with pytest.raises(TargetMismatch, match="9 x 7"):
        detect(image, TargetSpec("circles", 12, 9, 25.0))


def test_mirrored_prints_are_recognised_where_they_differ() -> None:
    """By the larger dot, and by the rows' order where there is an even number of staggered rows."""
    marked = replace(scene_of(SYMMETRIC, 15.0, seed=2), origin_dot=1.5, noise_levels=2.0)
    staggered = replace(scene_of(replace(ASYMMETRIC, rows=10), 20.0, seed=3), noise_levels=2.0)
    for scene in (marked, staggered):
        image = render(scene)
        assert detect(image, scene.target).labelling in ("absolute", "up_to_symmetry")
        with pytest.raises(TargetMirrored):
            detect(np.ascontiguousarray(image[:, ::-1]), scene.target)


@pytest.mark.parametrize("kind", ["circles", "asymmetric_circles"])
def test_boards_of_two_sizes_in_one_image_are_each_found(kind: str) -> None:
    sizes = ((9, 7), (7, 5)) if kind == "circles" else ((4, 11), (3, 9))
    scenes = [
        replace(scene_of(TargetSpec(kind, *size, 25.0), 20.0, seed, roll=0.3), noise_levels=2.0)
        for seed, size in enumerate(sizes)
    ]
    both = np.concatenate([render(scene) for scene in scenes], axis=1)
    for scene, shift in zip(scenes, (0.0, SIZE[0]), strict=True):
        found = detect(both, scene.target)
        assert len(found) == scene.target.size
        flipped = errors_either_way(scene, found)
        assert np.abs(flipped - np.array([shift, 0.0])).max() < 0.06
    twice = np.concatenate([render(scenes[0])] * 2, axis=1)
    with pytest.raises(TargetMismatch, match="2 grids"):
        detect(twice, scenes[0].target)


def errors_either_way(scene: Scene, found: GridPoints) -> np.ndarray:
    """The errors in the order that fits, of those in which the board looks the same."""
    turned = replace(
        found, column=scene.target.columns - 1 - found.column, row=scene.target.rows - 1 - found.row
    )
    return min(
        (errors(scene, each) for each in (found, turned)), key=lambda e: float(np.ptp(e, axis=0).max())
    )


def test_what_is_no_board_of_dots_is_rejected() -> None:
    chessboard = render(standard_scene(standard_target(9, 6), seed=1))
    noise = np.random.default_rng(0).integers(0, 256, (600, 800), dtype=np.uint8)
    for image in (chessboard, noise, np.full((600, 800), 128, np.uint8)):
        with pytest.raises((TargetNotFound, TargetMismatch)):  # what lies about may be a grid of its own
            detect(image, SYMMETRIC)


@pytest.mark.parametrize("turn_deg", [0.0, 20.0])
def test_a_grille_of_as_many_squares_is_no_board(turn_deg: float) -> None:
    """Though it has the size that is asked for; round dots at the same places are the board."""
    turn = cv2.getRotationMatrix2D((400.0, 300.0), turn_deg, 1.0)
    for is_round in (True, False):
        image = np.full((600, 800), 200, np.uint8)
        for row, column in np.ndindex(7, 9):
            u, v = 200 + 50 * column, 150 + 50 * row
            if is_round:
                cv2.circle(image, (u, v), 14, 40, -1)
            else:
                cv2.rectangle(image, (u - 12, v - 12), (u + 12, v + 12), 40, -1)
        image = cv2.GaussianBlur(cv2.warpAffine(image, turn, (800, 600), borderValue=200), (0, 0), 1.5)
        if is_round:
            assert len(detect(image, SYMMETRIC)) == SYMMETRIC.size
        else:
            with pytest.raises(TargetNotFound, match="square, not round"):
                detect(image, SYMMETRIC)
