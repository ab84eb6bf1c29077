"""Conditions under which boards must be found, and images in which none may be."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from core.errors import GridposeError, TargetMismatch, TargetNotFound
from core.geometry.camera import Camera
from core.geometry.se3 import so3_exp, transform
from core.simulation import Light, Scene
from core.targets import TargetSpec, detect
from core.targets.chessboard.detector import trace_detection
from tests.support.image.view_flaws import trail
from tests.support.simulation.renders import render
from tests.support.targets.corner_errors import LARGEST_ERROR_PX, worst
from tests.support.targets.drawn_boards import NINE_BY_SIX, checks, drawn_board

Take = Callable[..., tuple[Scene, np.ndarray]]


def small_squares(
    columns: int,
    rows: int,
    square_px: float,
    tilt_deg: float,
    size_px: tuple[int, int],
    seed: int,
    blur_px: float,
) -> Scene:
    """A board whose nearest lines are `square_px` apart, on the foreshortened side, in the middle of the image."""
    rng = np.random.default_rng([seed, columns, rows])
    target = TargetSpec("chessboard", columns, rows, 20.0)
    width, height = size_px
    camera = Camera(0.95 * width, 0.95 * width, width / 2 + 3, height / 2 - 4, k1=-0.1, k2=0.05)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    rotation = so3_exp(math.radians(tilt_deg) * axis) @ so3_exp(np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)]))
    middle = np.array([columns - 1, rows - 1, 0.0]) * target.pitch_mm / 2.0
    far = camera.fx_px * target.pitch_mm / square_px
    for _ in range(20):
        T = transform(rotation, np.array([0.0, 0.0, far]) - rotation @ middle)
        scene = Scene(target, camera, T, width, height)
        grid = scene.points_px.reshape(rows, columns, 2)
        a, b = np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1]
        area = np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
        far *= float((area / np.maximum(np.hypot(*a.T).T, np.hypot(*b.T).T)).min()) / square_px
    return dataclasses.replace(
        scene,
        blur_px=blur_px,
        noise_levels=4.0,
        light=Light(gradient=(0.15, -0.1), vignetting=0.2),
        clutter=1.0,
        seed=seed,
        background_seed=seed,
    )


def assert_found(
    image: np.ndarray, scene: Scene, *, least: float = 1.0, error_px: float = LARGEST_ERROR_PX
) -> None:
    found = detect(image, scene.target)
    assert worst(found, scene) < error_px
    assert len(found) >= least * scene.target.size
    codes = [w.code for w in found.warnings]
    assert ("points_missing" in codes) == (len(found) < scene.target.size)


@pytest.mark.parametrize("size_px", [(640, 480), (1600, 1300)])
@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 60.0])
@pytest.mark.parametrize("blur_px", [0.5, 1.0, 2.0])
def test_squares_of_8_px(size_px: tuple[int, int], tilt_deg: float, blur_px: float) -> None:
    """Found, every corner in its place; blur that reaches across half a square costs some, and they are named."""
    for seed, size in enumerate([(9, 6), (14, 10)]):
        scene = small_squares(*size, 8.0, tilt_deg, size_px, seed, blur_px)
        assert_found(render(scene), scene, least=1.0 if blur_px < 2.0 else 0.65)


@pytest.mark.parametrize(
    ("tilt_deg", "blur_px"), [(0.0, 0.5), (30.0, 0.5), (60.0, 0.5), (0.0, 3.0), (40.0, 3.0)]
)
def test_blur(take: Take, tilt_deg: float, blur_px: float) -> None:
    scene, image = take(9, 6, seed=11, tilt_deg=tilt_deg, max_roll_deg=180.0, blur_px=blur_px)
    assert_found(image, scene, least=0.95)


@pytest.mark.parametrize(
    ("share", "seed"), [(0.3, 54), (0.35, 57), pytest.param(0.35, 59, marks=pytest.mark.slow)]
)
def test_motion_along_the_diagonal_of_the_squares(share: float, seed: int) -> None:
    """Found where motion joins squares of one colour, and every corner in its place; `share` is of a diagonal."""
    scene = small_squares(9, 6, 28.0, 20.0, (640, 480), seed, 0.8)
    middle = scene.points_px.reshape(6, 9, 2)[2:4, 4:6]
    across = middle[1, 1] - middle[0, 0]
    sharp = render(dataclasses.replace(scene, noise_levels=0.0))
    kernel = trail(share * math.hypot(*across), math.atan2(across[1], across[0]))
    moved = cv2.filter2D(sharp, -1, kernel).astype(np.float64)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, moved.shape)
    assert_found(np.clip(np.rint(moved + noise), 0, 255).astype(np.uint8), scene, least=0.9)


@pytest.mark.parametrize("roll_deg", [0.0, 45.0, 90.0, 135.0, 180.0])
def test_any_roll(roll_deg: float) -> None:
    target = TargetSpec("chessboard", 9, 6, 20.0)
    rotation = so3_exp(np.array([0.3, -0.2, 0.0])) @ so3_exp(np.array([0.0, 0.0, math.radians(roll_deg)]))
    T = transform(rotation, np.array([0.0, 0.0, 420.0]) - rotation @ np.array([80.0, 50.0, 0.0]))
    scene = Scene(target, Camera(1000.0, 1000.0, 503.0, 396.0), T, 1000, 800, noise_levels=4.0, clutter=1.0)
    assert_found(render(scene), scene)


def test_low_contrast_and_noise(take: Take) -> None:
    scene, image = take(
        14, 10, seed=12, light=Light(90.0, 115.0, gradient=(0.1, 0.1)), noise_levels=2.5, clutter=0.5
    )
    assert_found(image, scene, least=0.95, error_px=0.6)
    scene, image = take(14, 10, seed=12, noise_levels=12.0)
    assert_found(image, scene, least=0.95, error_px=0.5)


@pytest.mark.parametrize("gamma", [0.45, 2.2])
def test_gamma(take: Take, gamma: float) -> None:
    """A non-linear camera moves no corner: the pattern is the same with black and white exchanged and turned."""
    scene, image = take(9, 6, seed=13)
    table = np.rint(255.0 * (np.arange(256) / 255.0) ** gamma).astype(np.uint8)
    assert_found(table[image], scene, least=0.95)


@pytest.mark.parametrize("shift", [0, 4])
def test_12_bits_in_16(take: Take, shift: int) -> None:
    scene, image = take(9, 6, seed=3, bit_depth=16)
    assert_found((image >> 4) << shift, scene)


def test_wide_angle() -> None:
    camera = Camera(560.0, 560.0, 650.0, 498.0, k1=-0.25, k2=0.06)
    target = TargetSpec("chessboard", 14, 10, 20.0)
    rotation = so3_exp(np.array([0.3, 0.3, 0.2]))
    T = transform(rotation, np.array([20.0, -10.0, 180.0]) - rotation @ np.array([130.0, 90.0, 0.0]))
    scene = Scene(target, camera, T, 1280, 960, noise_levels=4.0, clutter=1.0)
    trace = trace_detection(render(scene), target)
    assert trace.lattice is not None
    assert trace.lattice.known.all()
    truth = scene.points_px.reshape(10, 14, 2)
    assert min(np.abs(trace.lattice.grid - order).max() for order in (truth, truth[::-1, ::-1])) < 1.0


@pytest.mark.parametrize("seed", range(4))
def test_a_reflection_costs_corners_and_nothing_else(take: Take, seed: int) -> None:
    scene, image = take(14, 10, seed=seed)
    grid = scene.points_px.reshape(10, 14, 2)
    rng = np.random.default_rng(seed)
    middle = grid[rng.integers(3, 7), rng.integers(3, 11)]
    v, u = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    pitch = np.linalg.norm(grid[5, 6] - grid[5, 5])
    glare = 400.0 * np.exp(-(((u - middle[0]) ** 2 + (v - middle[1]) ** 2) / (2.0 * (0.9 * pitch) ** 2)))
    found = detect(np.clip(image + glare, 0, 255).astype(np.uint8), scene.target)
    assert worst(found, scene) < 0.5
    assert 0.85 * 140 < len(found) < 140
    assert "points_missing" in {w.code for w in found.warnings}


def test_a_large_image() -> None:
    """20 megapixels: found at full resolution's accuracy, here of a board whose corners lie at pixels' corners."""
    square = 300
    image = cv2.GaussianBlur(drawn_board(9, 6, square), (0, 0), 1.0)
    assert image.size > 20e6
    found = detect(image, NINE_BY_SIX)
    true = np.mgrid[5:11, 5:14].reshape(2, -1)[::-1].T * square - 0.5
    distances = np.linalg.norm(found.points_px[:, None] - true, axis=2)
    assert sorted(distances.argmin(axis=1)) == list(range(54))
    assert distances.min(axis=1).max() < 0.02


def winding_checks(kind: str, size: int) -> np.ndarray:
    v, u = np.mgrid[0:size, 0:size].astype(np.float32)
    if kind == "wavy":
        bent = cv2.remap(checks(9, (size, size)), u + 30 * np.sin(v / 60), v + 30 * np.sin(u / 70), 1)
        noisy = bent + np.random.default_rng(0).normal(0.0, 40.0, bent.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    radius = np.hypot(u - size / 2.0, v - size / 2.0) + 1e-3
    angle = np.arctan2(v - size / 2.0, u - size / 2.0)
    if kind == "polar":
        number = np.floor(np.log(radius) * 40.0 / np.pi) + np.floor(angle * 40.0 / np.pi)
    else:
        turns = radius - angle / (2.0 * np.pi) * 80.0
        number = np.floor(turns / 10.0) + np.floor(
            (np.floor(turns / 80.0) * 80.0 * angle + 40.0 * angle) / 10.0
        )
    return (number % 2 * 200 + 20).astype(np.uint8)


RUBBISH = {
    "noise": lambda rng, shape: rng.integers(0, 256, shape, dtype=np.uint8),
    "noise 16": lambda rng, shape: rng.integers(0, 65536, shape, dtype=np.uint16),
    "saturated": lambda rng, shape: np.where(rng.random(shape) < 0.5, 255, 0).astype(np.uint8),
    "texture": lambda rng, shape: cv2.GaussianBlur(rng.integers(0, 256, shape, dtype=np.uint8), (0, 0), 1.5),
    "half calm": lambda rng, shape: np.where(
        np.arange(shape[1]) < shape[1] // 2, 77, rng.integers(0, 256, shape)
    ).astype(np.uint8),
    "checks 1": lambda rng, shape: checks(1, shape),
    "checks 2": lambda rng, shape: checks(2, shape),
    "checks 3": lambda rng, shape: checks(3, shape),
    "checks 8": lambda rng, shape: checks(8, shape),
    "checks 10, blurred": lambda rng, shape: cv2.GaussianBlur(checks(10, shape), (0, 0), 1.0),
    "stripes": lambda rng, shape: np.broadcast_to(np.arange(shape[1]) // 4 % 2 * 255, shape).astype(np.uint8),
}


@pytest.mark.parametrize("shape", [(1, 1), (2, 5000), (7, 7), (40, 3000), (1200, 1600)], ids=str)
@pytest.mark.parametrize("kind", RUBBISH)
def test_rubbish_is_refused_in_time(kind: str, shape: tuple[int, int]) -> None:
    image = RUBBISH[kind](np.random.default_rng(0), shape)
    detect(cv2.GaussianBlur(drawn_board(9, 6).astype(image.dtype), (0, 0), 1.0), NINE_BY_SIX)  # compiles
    for size in ((9, 6), (3, 3)):
        began = time.process_time()
        with pytest.raises(GridposeError):
            detect(image, TargetSpec("chessboard", *size, 20.0))
        assert time.process_time() - began < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["spiral", "polar", "wavy"])
def test_checks_without_an_end_are_given_up_in_time(kind: str) -> None:
    """Lattices that wind and close on themselves: they are followed a bounded way, and never whole."""
    winding = winding_checks(kind, 2600)
    # As many squares, which end at the edge.
    wallpaper = cv2.GaussianBlur(checks(10, winding.shape), (0, 0), 1.0)
    detect(cv2.GaussianBlur(drawn_board(9, 6), (0, 0), 1.0), NINE_BY_SIX)  # compiles
    times = []
    for image in (wallpaper, winding):
        began = time.process_time()
        with pytest.raises(TargetMismatch, match="at least"):
            detect(image, NINE_BY_SIX)
        times.append(time.process_time() - began)
    assert times[1] < 8.0 * times[0]  # the spiral takes 2.3 times as long; without a bound it has no end


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["spiral", "polar", "wavy"])
def test_squares_without_an_end_are_no_dots_in_time(kind: str) -> None:
    """Hundreds of lattices, of which each goes on beyond gaps: few are followed, no further than a board reaches."""
    winding = winding_checks(kind, 2600)
    wallpaper = cv2.GaussianBlur(checks(10, winding.shape), (0, 0), 1.0)
    dots = TargetSpec("circles", 10, 10, 20.0)
    times = []
    for image in (checks(10, (100, 100)), wallpaper, winding):  # the first compiles
        began = time.process_time()
        with pytest.raises((TargetNotFound, TargetMismatch)):
            detect(image, dots)
        times.append(time.process_time() - began)
    assert times[2] < 8.0 * times[1]


def test_a_wallpaper_of_squares_is_larger_than_the_board() -> None:
    with pytest.raises(TargetMismatch, match="at least"):
        detect(cv2.GaussianBlur(checks(12, (1200, 1600)), (0, 0), 1.0), TargetSpec("chessboard", 9, 6, 20.0))


def test_squares_too_small_to_judge_are_said_to_be() -> None:
    scene = small_squares(9, 6, 4.8, 0.0, (640, 480), 1, 0.5)
    with pytest.raises(TargetNotFound, match="9 x 6 is in view, but its squares are only 5 px wide"):
        detect(render(scene), scene.target)


@pytest.mark.slow
def test_time_grows_with_the_number_of_corners_not_with_its_square() -> None:
    taken = []
    for lines in (20, 100, 200):  # the first compiles
        image = cv2.GaussianBlur(drawn_board(lines, lines, 10), (0, 0), 0.6)
        runs = []
        for _ in range(2):
            began = time.process_time()
            found = detect(image, TargetSpec("chessboard", lines, lines, 5.0))
            runs.append(time.process_time() - began)
            assert len(found) == lines * lines
        taken.append(min(runs))
    assert taken[2] < 8.0 * taken[1]  # four times as many corners: 4 if in proportion, 16 by their square
