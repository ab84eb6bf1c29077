"""Refined corners against rendered truth: how far off, how well stated, and which are not believed."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from core.errors import DegenerateGeometry
from core.geometry.camera import Camera
from core.simulation import Light, Scene, standard_scene, standard_target
from core.targets.subpixel import corner_model as model
from core.targets.subpixel.corner_acceptance import RefinedCorners
from core.targets.subpixel.corner_motion import move_corners
from core.targets.subpixel.corner_step import step_corners
from core.targets.subpixel.refinement import refine_corners
from core.targets.subpixel.smooth_map import grid_basis, grid_shape
from tests.support.cramer_rao import corner_bounds
from tests.support.simulation.renders import render, render_levels

Take = Callable[..., tuple[Scene, np.ndarray]]


def refine_scene(scene: Scene, image: np.ndarray, off_px: float = 0.7, **options: float) -> RefinedCorners:
    grid = scene.grid_points
    start = grid.points_px + np.random.default_rng(1).uniform(-off_px, off_px, grid.points_px.shape)
    return refine_corners(image, grid.column, grid.row, start, origin_is_black=True, **options)


def rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


def normalised(refined: RefinedCorners, scene: Scene) -> np.ndarray:
    error = (refined.points_px - scene.points_px) / refined.standard_uncertainty_px[:, None]
    return error[refined.trusted]


def to_8_bit(levels: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    levels = levels + noise * np.random.default_rng(seed).standard_normal(levels.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    "size",
    [(9, 6), pytest.param((14, 10), marks=pytest.mark.slow), pytest.param((25, 18), marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("tilt_deg", [pytest.param(0.0, marks=pytest.mark.slow), 30.0, 60.0])
def test_errors_are_as_stated(take: Take, size: tuple[int, int], tilt_deg: float) -> None:
    scene, image = take(*size, seed=2, tilt_deg=tilt_deg)
    refined = refine_scene(scene, image)
    assert refined.trusted.all()
    # of n independent corners the rms of the 2 n normalised errors scatters by 1 / (2 sqrt(n))
    assert rms(normalised(refined, scene)) == pytest.approx(
        1.0, abs=0.03 + 1.5 / math.sqrt(len(refined.trusted))
    )
    assert np.median(refined.blur_px) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    "blur_px",
    [0.3, pytest.param(0.5, marks=pytest.mark.slow), pytest.param(1.0, marks=pytest.mark.slow), 2.0],
)
@pytest.mark.parametrize(
    "tilt_deg", [pytest.param(0.0, marks=pytest.mark.slow), 30.0, pytest.param(50.0, marks=pytest.mark.slow)]
)
def test_without_noise_next_to_nothing_is_left(take: Take, blur_px: float, tilt_deg: float) -> None:
    """What is left is the rounding to whole levels, and stated."""
    scene, image = take(9, 6, seed=4, tilt_deg=tilt_deg, blur_px=blur_px, noise_levels=0.0)
    refined = refine_scene(scene, image)
    error = (refined.points_px - scene.points_px)[refined.trusted]
    assert refined.trusted.sum() >= 50
    assert rms(error) < 0.003
    assert np.linalg.norm(error.mean(axis=0)) < 0.001
    assert np.median(refined.blur_px) == pytest.approx(blur_px, abs=0.02)


@pytest.mark.parametrize("roll_deg", [0.0, 180.0])
def test_pixel_aligned_boards_have_no_bias(roll_deg: float) -> None:
    """Every line of pixels cuts an edge at the same phase, so that nothing averages out."""
    camera = Camera(1000.0, 1000.0, 499.5, 399.5)
    target = standard_target(9, 6)
    for shift in (0.0, 0.25, 0.5):
        T = np.eye(4)
        T[:3, 3] = (-133.2 + shift * target.pitch_mm / 40.0, -83.25, target.pitch_mm * 1000.0 / 60.0)
        scene = Scene(target, camera, T, 1000, 800, blur_px=0.5, bit_depth=16)
        refined = refine_scene(scene, render(scene))
        assert refined.trusted.all()
        assert np.abs(refined.points_px - scene.points_px).max() < 0.001


@pytest.mark.parametrize(
    ("what", "change"),
    [
        ("gamma", lambda g: 255.0 * (g / 255.0) ** (1.0 / 2.2)),
        ("inverse gamma", lambda g: 255.0 * (g / 255.0) ** 2.2),
        ("ink spread", lambda g: 0.8 * g + 0.2 * cv2.erode(g.astype(np.float32), np.ones((3, 3), np.uint8))),
        ("motion", lambda g: cv2.blur(g.astype(np.float32), (3, 1))),
        ("reflex", lambda g: g + 40.0 * np.exp(-0.5 * ((np.arange(1000.0)[None] - 450.0) / 150.0) ** 2)),
    ],
)
def test_what_cameras_and_prints_do_moves_no_corner(
    take: Take, what: str, change: Callable[[np.ndarray], np.ndarray]
) -> None:
    scene, _ = take(9, 6, seed=1, tilt_deg=30.0, noise_levels=0.0, light=Light(gradient=(0.15, -0.1)))
    refined = refine_scene(scene, to_8_bit(change(np.clip(render_levels(scene), 0.0, 250.0))))
    error = refined.points_px - scene.points_px
    assert refined.trusted.mean() > 0.9
    assert rms(error[refined.trusted]) < 0.005, what
    assert np.linalg.norm(error[refined.trusted].mean(axis=0)) < 0.001


def test_steep_light_and_a_strong_lens(take: Take) -> None:
    light = Light(gradient=(0.5, -0.4), vignetting=0.5)
    scene, image = take(9, 6, seed=3, noise_levels=0.0, light=light)
    refined = refine_scene(scene, image)
    assert rms((refined.points_px - scene.points_px)[refined.trusted]) < 0.003
    lens = Camera(1000.0, 1000.0, 503.0, 396.0, k1=-0.3, k2=0.1)
    scene, image = take(14, 10, seed=3, noise_levels=0.0, camera=lens)
    refined = refine_scene(scene, image)
    assert rms((refined.points_px - scene.points_px)[refined.trusted]) < 0.003


def test_8_and_16_bit_agree(take: Take) -> None:
    scene, image = take(9, 6, seed=3)
    narrow, wide = (refine_scene(scene, p) for p in (image, image.astype(np.uint16) * 257))
    np.testing.assert_allclose(wide.points_px, narrow.points_px, atol=1e-9)
    np.testing.assert_allclose(wide.standard_uncertainty_px, narrow.standard_uncertainty_px, rtol=1e-6)
    np.testing.assert_allclose(wide.contrast, narrow.contrast * 257.0, rtol=1e-9)


def test_any_part_of_a_grid_serves(take: Take) -> None:
    scene, image = take(14, 10, seed=5)
    grid = scene.grid_points
    some = np.random.default_rng(0).permutation(len(grid))[:60]
    refined = refine_corners(
        image, grid.column[some] + 3, grid.row[some] + 4, grid.points_px[some], origin_is_black=False
    )
    assert refined.trusted.all()
    error = (refined.points_px - grid.points_px[some]) / refined.standard_uncertainty_px[:, None]
    assert rms(error) == pytest.approx(1.0, abs=0.2)


def test_a_shorter_reach_knows_less(take: Take) -> None:
    scene, image = take(9, 6, seed=2)
    half, fifth = (refine_scene(scene, image, largest_reach=reach) for reach in (0.5, 0.2))
    ratio = fifth.standard_uncertainty_px / half.standard_uncertainty_px
    assert np.median(ratio) == pytest.approx(math.sqrt(0.5 / 0.2), rel=0.1)


@pytest.mark.parametrize("share", [0.0005, 0.005])
def test_dead_and_hot_pixels_are_rejected(take: Take, share: float) -> None:
    scene, image = take(9, 6, seed=2)
    rng = np.random.default_rng(3)
    stray = image.copy()
    struck = rng.random(image.shape) < share
    stray[struck] = rng.choice([0, 255], struck.sum())
    clean, struck_by = refine_scene(scene, image), refine_scene(scene, stray)
    assert struck_by.trusted.all()
    assert rms(struck_by.points_px - scene.points_px) < 1.1 * rms(clean.points_px - scene.points_px) + 1e-3


def test_wrong_colours_are_not_believed(take: Take) -> None:
    scene, image = take(9, 6, seed=2)
    grid = scene.grid_points
    refined = refine_corners(image, grid.column, grid.row, grid.points_px, origin_is_black=False)
    assert not refined.trusted.any()
    assert np.isinf(refined.standard_uncertainty_px).all()
    np.testing.assert_array_equal(refined.points_px, grid.points_px)


def test_covered_corners_are_not_believed_and_spoil_no_other(take: Take) -> None:
    scene, image = take(9, 6, seed=2, tilt_deg=10.0)
    points = scene.points_px
    covered = image.copy()
    for k in (12, 40):  # blots over the corner itself
        cv2.circle(covered, tuple(np.rint(points[k]).astype(int).tolist()), 9, 128, -1, cv2.LINE_AA)
    a, b = (np.rint(points[k] + (5.0, 3.0)).astype(int).tolist() for k in (18, 26))
    cv2.line(covered, a, b, 60, 5, cv2.LINE_AA)  # a cable along a row of corners, and over them
    refined = refine_scene(scene, covered)
    assert not refined.trusted[[12, 40]].any()
    error = np.linalg.norm(refined.points_px - points, axis=1)[refined.trusted]
    assert np.all(error < 6.0 * refined.standard_uncertainty_px[refined.trusted])
    away = np.delete(np.arange(54), [12, 40, *range(18, 27)])
    assert refined.trusted[away].mean() > 0.9


@pytest.mark.parametrize(
    ("peak_levels", "seeds"),
    [
        (200.0, range(2)),
        *(pytest.param(peak, range(6), marks=pytest.mark.slow) for peak in (80.0, 200.0, 500.0)),
    ],
)
def test_lamps_mirrored_in_the_board_are_in_the_uncertainty(
    take: Take, peak_levels: float, seeds: range
) -> None:
    """Broad light added, cut off at 255 where it is strong: its slopes are known by the corners alone, and badly."""
    errors, trusted, size = [], 0, 0
    for seed in seeds:
        scene, _ = take(14, 10, seed, 20.0 + 5.0 * seed, 180.0, light=Light())
        points, rng = scene.points_px, np.random.default_rng(seed)
        at, spread = (
            points[rng.integers(len(points))],
            rng.uniform(0.08, 0.3, 2) * np.ptp(points, axis=0).max(),
        )
        u, v = (np.exp(-0.5 * ((np.arange(n) - at[k]) / spread[k]) ** 2) for k, n in enumerate((1000, 800)))
        refined = refine_scene(
            scene, to_8_bit(render_levels(scene) + peak_levels * np.outer(v, u), 4.0, seed)
        )
        errors.append(normalised(refined, scene))
        trusted, size = trusted + int(refined.trusted.sum()), size + len(points)
    error = np.concatenate(errors)
    assert trusted > 0.6 * size  # the others are burnt out
    assert rms(error) < 2.2  # at 200 levels 4.5, were the slopes taken for certain
    assert np.mean(np.abs(error) > 6.0) < 0.04


@pytest.mark.parametrize(
    "seed", [2, pytest.param(3, marks=pytest.mark.slow), pytest.param(5, marks=pytest.mark.slow)]
)
def test_bends_of_an_outline_are_no_crossings(take: Take, seed: int) -> None:
    """Where one of the four squares is missing, the one opposite still has its corner there."""
    scene, image = take(9, 6, seed=seed, tilt_deg=25.0, noise_levels=1.0)
    points = scene.points_px.reshape(6, 9, 2)
    black = np.rint(points[[2, 2, 3, 3], [4, 5, 5, 4]]).astype(np.int32)
    covered = cv2.dilate(cv2.fillConvexPoly(np.zeros_like(image), black, 1), np.ones((7, 7), np.uint8))
    u, v = np.rint(points[2:4, 5:7].mean(axis=(0, 1))).astype(int)  # in the white one next to it
    refined = refine_scene(scene, np.where(covered == 1, image[v, u], image))
    trusted = refined.trusted.reshape(6, 9)
    assert not trusted[2:4, 4:6].any()
    assert trusted.sum() == 50


@pytest.mark.parametrize(
    "views",
    [((1, 25.0),), pytest.param(((0, 10.0), (1, 25.0), (2, 40.0), (3, 50.0)), marks=pytest.mark.slow)],
    ids=["one", "all"],
)
def test_thresholded_images_are_measured_with_their_uncertainty(
    take: Take, views: tuple[tuple[int, float], ...]
) -> None:
    """Steps of whole pixels along the edges: no blur determines a place, and neighbours' errors are in unison."""
    errors, trusted = [], []
    for seed, tilt_deg in views:
        scene, image = take(14, 10, seed, tilt_deg, 180.0, blur_px=0.1, noise_levels=0.0, light=Light())
        refined = refine_scene(scene, np.where(image > 117, 210, 30).astype(np.uint8))
        errors.append(normalised(refined, scene))
        trusted.append(refined.trusted.mean())
    assert np.mean(trusted) > 0.8  # of lines along the pixels' rows next to nothing is known
    assert max(trusted) > 0.95
    assert 0.4 < rms(np.concatenate(errors)) < 1.2


def test_the_edge_of_a_reflex_is_noticed(take: Take) -> None:
    scene, image = take(9, 6, seed=2, tilt_deg=10.0)
    points = scene.points_px
    u = 0.5 * (points[3, 0] + points[4, 0]) - 20.0
    lit = image.astype(np.float64)
    lit[:, int(u) :] = 0.4 * lit[:, int(u) :] + 140.0
    refined = refine_scene(scene, to_8_bit(lit))
    error = np.linalg.norm(refined.points_px - points, axis=1)[refined.trusted]
    assert np.all(error < 6.0 * refined.standard_uncertainty_px[refined.trusted])
    assert refined.trusted.mean() > 0.6


def test_corners_at_the_images_border(take: Take) -> None:
    scene, image = take(9, 6, seed=2, tilt_deg=0.0, max_roll_deg=0.0)
    grid = scene.grid_points
    left = int(grid.points_px[0, 0]) - 1  # cut through the first column of corners
    refined = refine_corners(
        image[:, left:],
        grid.column,
        grid.row,
        grid.points_px - np.array([left, 0.0]),
        origin_is_black=True,
    )
    assert not refined.trusted[0]
    assert refined.trusted[grid.column > 0].all()
    error = (refined.points_px + np.array([left, 0.0]) - grid.points_px)[refined.trusted]
    assert rms(error / refined.standard_uncertainty_px[refined.trusted, None]) < 1.3


def test_far_starts_and_missing_ones(take: Take) -> None:
    scene, image = take(9, 6, seed=2)
    grid = scene.grid_points
    start = grid.points_px + np.random.default_rng(1).uniform(-1.2, 1.2, grid.points_px.shape)
    start[7] += 15.0
    start[20] = np.nan
    refined = refine_corners(image, grid.column, grid.row, start, origin_is_black=True)
    assert not refined.trusted[[7, 20]].any()
    others = np.delete(np.arange(54), [7, 20])
    assert refined.trusted[others].all()
    assert rms(normalised(refined, scene)) == pytest.approx(1.0, abs=0.25)


def test_no_corner_takes_its_neighbours_place(take: Take) -> None:
    """Small squares: a start well on the way to the diagonal neighbour, of the same colours, leads to that."""
    scene, image = take(9, 6, seed=2, tilt_deg=0.0)
    size = 7.0 / float(np.min(np.linalg.norm(np.diff(scene.points_px.reshape(6, 9, 2), axis=1), axis=2)))
    small = cv2.resize(image, None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
    points = (scene.points_px + 0.5) * [
        small.shape[1] / image.shape[1],
        small.shape[0] / image.shape[0],
    ] - 0.5
    grid = scene.grid_points
    for share in (0.5, 0.7, 0.8, 0.9):
        start = points.copy()
        start[22] += share * (points[32] - points[22])
        refined = refine_corners(small, grid.column, grid.row, start, origin_is_black=True)
        error = np.linalg.norm(refined.points_px - points, axis=1)
        assert refined.trusted.sum() > 40
        assert error[refined.trusted].max() < 0.5


def test_too_few_points_are_refused(take: Take) -> None:
    scene, image = take(9, 6, seed=2)
    grid = scene.grid_points
    for chosen in (np.arange(3), np.arange(9)):  # three; a line
        with pytest.raises(DegenerateGeometry):
            refine_corners(
                image,
                grid.column[chosen],
                grid.row[chosen],
                grid.points_px[chosen],
                origin_is_black=True,
            )


@pytest.mark.parametrize("seed", range(6))
def test_images_without_corners_give_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(20, 200)), int(rng.integers(20, 200)))
    image = rng.integers(0, 256, shape, dtype=np.uint8) if seed % 2 else np.full(shape, 90, np.uint8)
    row, column = (a.ravel() for a in np.mgrid[0:5, 0:6])
    start = np.stack([column, row], axis=1) * rng.uniform(2.0, 40.0) + rng.uniform(-30.0, 30.0, 2)
    refined = refine_corners(image, column, row, start, origin_is_black=True)
    assert refined.trusted.sum() <= 3
    assert np.isfinite(refined.points_px).all()


@pytest.mark.parametrize("angle_deg", [3.0, 40.0, 70.0, 130.0])
@pytest.mark.parametrize("between_deg", [90.0, 75.0])
@pytest.mark.parametrize(("sigmas_px", "rtol"), [((1.1, 1.4), 3e-3), ((0.35, 0.5), 0.03)])
def test_kernel_against_its_twin(
    angle_deg: float, between_deg: float, sigmas_px: tuple[float, float], rtol: float
) -> None:
    """One step of the compiled kernel is the plain least-squares solution over the same pixels.

    P of the other edge is ±1 to 3e-3 where the kernel takes it for that, and Mehler's series is cut off: of sharp edges
    the few pixels near the crossing, where this matters, are a tenth of all.
    """
    state = np.zeros(model.STATE)
    state[[model.Q_U, model.Q_V]] = 33.3, 28.8
    for at, angle in ((model.N1_U, angle_deg), (model.N2_U, angle_deg + between_deg)):
        state[at : at + 2] = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    state[[model.REACH_1, model.REACH_2]] = 14.0, 12.0
    state[[model.SIGMA_1, model.SIGMA_2]] = sigmas_px
    state[[model.SPACING_1, model.SPACING_2]] = 40.0
    state[[model.LEVEL_U, model.LEVEL_V, model.CONTRAST_U, model.CONTRAST_V]] = 0.1, -0.2, 0.05, 0.1
    state[model.SIGN], state[model.PER_CONTRAST] = -1.0, 0.01
    v, u = np.mgrid[0:60, 0:70]
    d = np.stack([u - 33.2, v - 29.0], axis=2) @ state[
        [model.N1_U, model.N2_U, model.N1_V, model.N2_V]
    ].reshape(2, 2)
    noise = 5.0 * np.random.default_rng(int(angle_deg)).standard_normal(u.shape)
    profiles = np.tanh(1.2 * d / sigmas_px)
    image = to_8_bit(120.0 - 80.0 * profiles[..., 0] * profiles[..., 1] + noise)
    columns, grey, weight = twin_rows(image, state)
    root = np.sqrt(weight)[:, None]
    solution = np.linalg.lstsq(columns * root, grey * root[:, 0], rcond=None)[0]
    residual = (grey - columns @ solution) * root[:, 0]
    N = state[[model.N1_U, model.N1_V, model.N2_U, model.N2_V]].reshape(2, 2)
    delta = np.linalg.solve(N, solution[:2] / solution[3])
    covariance = np.linalg.inv((columns * root).T @ (columns * root))[:2, :2] / solution[3] ** 2
    covariance = np.linalg.inv(N) @ covariance @ np.linalg.inv(N).T
    steps = np.full((1, model.STEP), np.nan)
    step_corners(image, state[None], np.array([0]), 1, True, steps)
    step = steps[0]
    np.testing.assert_allclose(step[[model.STEP_U, model.STEP_V]], delta, rtol=rtol, atol=1e-4)
    np.testing.assert_allclose(step[[model.LEVEL, model.CONTRAST]], solution[2:4], rtol=rtol)
    assert step[model.SAMPLES] == pytest.approx(weight.sum(), rel=1e-9)
    assert step[model.SQUARES] == pytest.approx(np.sum(residual**2), rel=max(0.01, rtol))
    expected = covariance[[0, 0, 1], [0, 1, 1]]
    stated = step[[model.COV_UU, model.COV_UV, model.COV_VV]]
    np.testing.assert_allclose(stated, expected, atol=5e-3 * np.abs(expected).max())


def test_the_maps_polynomial_is_that_of_least_squares() -> None:
    """The compiled solution against numpy's, of as many terms as the points call for."""
    rng = np.random.default_rng(2)
    row, column = (a.ravel() for a in np.mgrid[0:7, 0:9])
    x, y = column / 4.0 - 1.0, row / 3.0 - 1.0
    ideal = np.stack([column, row], axis=1).astype(np.float64)
    straight = 40.0 * ideal + 100.0
    basis = grid_basis(ideal, straight, np.ones(63))
    for degree, bend in ((1, np.zeros(63)), (2, 3.0 * x * y), (3, 2.0 * x**3 - y**2 * x)):
        points = straight + np.stack([bend, -bend], axis=1) + 0.01 * rng.standard_normal((63, 2))
        terms = (degree + 1) * (degree + 2) // 2
        B = np.column_stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)])
        expected = B @ np.linalg.lstsq(B, points, rcond=None)[0]
        found = grid_shape(basis, points).points_px
        assert B.shape[1] == terms
        # a chance term more moves the points by its share of the noise
        assert rms(found - expected) < 0.01 * math.sqrt(6.0 / 63.0)


def twin_rows(image: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The kernel's rows for straight edges far from others, each pixel on its own, by the formulas of its docstring."""
    v, u = (a.ravel() for a in np.mgrid[0 : image.shape[0], 0 : image.shape[1]])
    d = np.stack([u - s[model.Q_U], v - s[model.Q_V]], axis=1)
    n = s[[model.N1_U, model.N1_V, model.N2_U, model.N2_V]].reshape(2, 2)
    sigma, reach = s[[model.SIGMA_1, model.SIGMA_2]], s[[model.REACH_1, model.REACH_2]]
    x = d @ n.T / sigma
    half = np.maximum(model.BAND * sigma, model.MIN_BAND_PX - model.BAND * sigma / 1.5) / sigma
    weights = []
    for k in range(2):
        axis = 1 if abs(n[k, 0]) >= abs(n[k, 1]) else 0  # lines run along the other one
        extent = reach[k] * abs(n[k, 1 - axis])
        weights.append(np.clip(extent + 0.5 - np.abs(d[:, axis]), 0.0, 1.0) * (np.abs(x[:, k]) <= half[k]))
    along_1 = np.abs(d @ np.array([-n[0, 1], n[0, 0]]))
    weights[1] = weights[1] * ~((np.abs(x[:, 0]) <= half[0]) & (along_1 <= reach[0]))
    rows, greys, kept = [], [], []
    for k in range(2):
        used = weights[k] > 0.0
        top = -np.sum(n**4, axis=1) / (120.0 * 24.0 * sigma**4)
        bell = np.exp(-0.5 * x[used] ** 2) / math.sqrt(2.0 * math.pi)
        P = 2.0 * ndtr(x[used]) - 1.0 - 2.0 * top * bell * (x[used] ** 3 - 3.0 * x[used])
        slope = 2.0 * bell * (1.0 + top * (x[used] ** 4 - 6.0 * x[used] ** 2 + 3.0))
        rho = float(n[0] @ n[1])
        rest = math.sqrt(1.0 - rho * rho)
        given = np.stack(
            [
                2.0 * ndtr((x[used, 1] - rho * x[used, 0]) / rest) - 1.0,
                2.0 * ndtr((x[used, 0] - rho * x[used, 1]) / rest) - 1.0,
            ],
            axis=1,
        )
        excess = 4.0 * bivariate_excess(x[used, 0], x[used, 1], rho)
        T = s[model.SIGN] * (P[:, 0] * P[:, 1] + excess)
        T_x = s[model.SIGN] * slope * given
        contrast = d[used] @ s[[model.CONTRAST_U, model.CONTRAST_V]]
        strong = (1.0 + contrast * s[model.PER_CONTRAST])[:, None]
        rows.append(
            np.column_stack(
                [
                    -strong * T_x / sigma,
                    np.ones(len(T)),
                    T,
                    -strong * x[used] * T_x,
                    strong[:, 0] * (1.0 - T * T),
                ]
            )
        )
        level = d[used] @ s[[model.LEVEL_U, model.LEVEL_V]]
        greys.append(image[v[used], u[used]] - level - T * contrast)
        kept.append(weights[k][used])
    return np.concatenate(rows), np.concatenate(greys), np.concatenate(kept)


def bivariate_excess(x: np.ndarray, y: np.ndarray, rho: float) -> np.ndarray:
    """Φ₂(x, y; ρ) - Φ(x) Φ(y), the integral of the density over the correlation (R. L. Plackett, 1954)."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    total = np.zeros_like(x)
    for node, weight in zip(nodes, weights, strict=True):
        r = 0.5 * rho * (node + 1.0)
        q = 1.0 - r * r
        density = np.exp(-(x * x - 2.0 * r * x * y + y * y) / (2.0 * q)) / (2.0 * math.pi * math.sqrt(q))
        total += 0.5 * rho * weight * density
    return total


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise_levels", "blur_px"), [(1.0, 0.5), (1.0, 2.0), (4.0, 1.0), (8.0, 0.5), (8.0, 2.0)]
)
def test_normalised_errors_have_unit_variance(take: Take, blur_px: float, noise_levels: float) -> None:
    errors = []
    for seed, tilt_deg in enumerate((0.0, 20.0, 40.0, 50.0)):
        scene, image = take(14, 10, seed, tilt_deg, 180.0, blur_px=blur_px, noise_levels=noise_levels)
        errors.append(normalised(refine_scene(scene, image), scene))
    error = np.concatenate(errors)
    # 2 n = 1120 errors: the rms scatters by .021
    assert rms(error) == pytest.approx(1.0, abs=0.07)
    assert np.abs(error).max() < 5.5


@pytest.mark.slow
@pytest.mark.parametrize("quality", [95, 80])
@pytest.mark.parametrize("noise_levels", [0.0, 1.0, 4.0])
def test_compressed_images_are_not_overrated(take: Take, quality: int, noise_levels: float) -> None:
    errors = []
    for seed, tilt_deg in enumerate((5.0, 30.0, 45.0, 55.0)):
        scene, image = take(9, 6, seed, tilt_deg, 180.0, noise_levels=noise_levels)
        _, file = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        again = cv2.imdecode(file, cv2.IMREAD_GRAYSCALE)
        errors.append(normalised(refine_scene(scene, again), scene))
    assert 0.6 < rms(np.concatenate(errors)) < 1.25


@pytest.mark.slow
@pytest.mark.parametrize(("size", "scenes"), [((9, 6), 3), ((14, 10), 2), ((25, 18), 1)])
def test_standard_scenes_are_at_the_bound(size: tuple[int, int], scenes: int) -> None:
    squares, bounds = [], []
    for seed in range(100, 100 + scenes):
        scene = standard_scene(standard_target(*size), seed)
        refined = refine_scene(scene, render(scene))
        assert refined.trusted.mean() > 0.99
        error = refined.points_px - scene.points_px
        squares.append(np.mean(error[refined.trusted] ** 2))
        bounds.append(np.mean(corner_bounds(scene).standard_deviation_px[refined.trusted] ** 2))
        # noise alone gives the mean of n corners an error of its own
        mean_noise = math.sqrt(bounds[-1] / len(error))
        assert np.abs(error[refined.trusted].mean(axis=0)).max() < 0.001 + 3.0 * mean_noise
    corners = scenes * size[0] * size[1]
    assert math.sqrt(np.mean(squares) / np.mean(bounds)) < 1.05 + 2.0 / math.sqrt(4.0 * corners)


def test_a_step_of_a_few_corners_leaves_the_others_their_blur() -> None:
    """Those few may be the ones that a highlight blurs: what is usual is what all corners have."""
    states, steps = np.zeros((20, model.STATE)), np.zeros((20, model.STEP))
    states[:, [model.SIGMA_1, model.SIGMA_2]] = np.linspace(0.8, 0.9, 20)[:, None]
    steps[:, model.CONTRAST] = 50.0
    steps[18, model.STEP_U] = np.nan
    before = states.copy()
    chosen = np.array([18, 19])
    for _ in range(4):
        steps[19, [model.WIDER_1, model.WIDER_2]] = 0.7
        move_corners(states, steps, chosen, True, 1.5, 2.0, 0.3, 8.0)
    np.testing.assert_array_equal(states[:19], before[:19])
    assert states[19, model.SIGMA_1] == pytest.approx(2.0 * np.median(before[:18, model.SIGMA_1]), rel=0.03)
