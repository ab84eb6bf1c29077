"""The renderer is exact: proved against heavy supersampling, by its levels at known places, and by fitted edges."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest
import scipy.special
import scipy.stats

from core.errors import InvalidArgument, InvalidTarget
from core.geometry.camera import Camera, project, undistort_points
from core.geometry.se3 import compose, invert, so3_exp, transform, transform_points
from core.simulation import Light, Scene, render
from core.simulation.pattern_coverage import bivariate_excess, normal_share
from core.simulation.renderer import pixel_means, render_levels
from core.targets.specification import TargetSpec
from tests.support.simulation.scenes import standard_scene, standard_target

CAMERA = Camera(300.0, 310.0, 81.3, 58.4, k1=-0.25, k2=0.08, p1=1e-3, p2=-5e-4)
TARGET = TargetSpec("chessboard", 5, 4, pitch_mm=10.0)
PLAIN = Light(black_level=0.0, white_level=1.0)


def pose(tilt_deg: float, around_deg: float, distance_mm: float = 180.0) -> np.ndarray:
    around = math.radians(around_deg)
    rotation = so3_exp(math.radians(tilt_deg) * np.array([math.cos(around), math.sin(around), 0.0]))
    rotation = rotation @ so3_exp(np.array([0.0, 0.0, 0.3]))
    middle = transform(np.eye(3), -np.array([20.0, 15.0, 0.0]))
    return compose(transform(rotation, np.array([0.0, 0.0, distance_mm])), middle)


def small_scene(**changes: object) -> Scene:
    scene = Scene(TARGET, CAMERA, pose(35.0, 70.0), width_px=160, height_px=120, light=PLAIN, quiet_zone=0.8)
    return dataclasses.replace(scene, **changes)


def supersampled(scene: Scene, window: tuple[int, int, int, int], factor: int = 16) -> np.ndarray:
    """Return a window (left, top, right, bottom) inside the board, made the long way.

    Rays through `factor`² places a pixel; each place has the share of black and white that its small square has
    (from its distance to the nearest edges); blurred with a sampled Gaussian and averaged over the pixel.
    """
    left, top, right, bottom = window
    halo = math.ceil(6.0 * scene.blur_px) + 1
    u = left - halo - 0.5 + (np.arange((right - left + 2 * halo) * factor) + 0.5) / factor
    v = top - halo - 0.5 + (np.arange((bottom - top + 2 * halo) * factor) + 0.5) / factor
    places = np.stack([a.ravel() for a in np.meshgrid(u, v)], axis=1)
    rays = np.column_stack([undistort_points(places, scene.camera), np.ones(len(places))])
    T_target_camera = invert(scene.T_camera_target)
    rays, origin = rays @ T_target_camera[:3, :3].T, T_target_camera[:3, 3]
    hit = (origin - rays * (origin[2] / rays[:, 2])[:, None])[:, :2] / scene.target.pitch_mm
    x, y = (hit[:, k].reshape(len(v), len(u)) for k in range(2))
    assert x.min() > -1.0
    assert y.min() > -1.0
    assert x.max() < scene.target.columns
    assert y.max() < scene.target.rows
    white = (np.floor(x) + np.floor(y)) % 2
    share = np.ones_like(x)
    for w in (x, y):
        distance = np.abs(w - np.rint(w)) / np.hypot(*np.gradient(w))  # in small squares
        share *= np.minimum(1.0, 2.0 * distance)
    ink = 0.5 + (white - 0.5) * share
    reach = np.arange(-math.ceil(6.0 * scene.blur_px * factor), math.ceil(6.0 * scene.blur_px * factor) + 1)
    kernel = np.exp(-0.5 * (reach / (scene.blur_px * factor)) ** 2)
    ink = cv2.sepFilter2D(ink, cv2.CV_64F, kernel / kernel.sum(), kernel / kernel.sum())
    averaged = ink.reshape(len(v) // factor, factor, len(u) // factor, factor).mean(axis=(1, 3))
    return averaged[halo:-halo, halo:-halo]


def windows_around(scene: Scene, points_px: np.ndarray, reach: int) -> list[tuple[int, int, int, int]]:
    places = np.rint(points_px).astype(int)
    return [(u - reach, v - reach, u + reach + 1, v + reach + 1) for u, v in places.tolist()]


@pytest.mark.parametrize("blur_px", [0.3, 0.6, 1.0, 2.0])
def test_levels_equal_supersampling(blur_px: float) -> None:
    scene = small_scene(blur_px=blur_px)
    levels = render_levels(scene)
    for window in windows_around(scene, scene.points_px[[6, 8, 13]], 9):
        truth = supersampled(scene, window)
        rendered = levels[window[1] : window[3], window[0] : window[2]]
        assert truth.max() - truth.min() > 0.9
        # What is left is the fourth moment of a pixel that is sampled at m places; it matters least where the
        # blur is wide. It is even in every direction and moves nothing, as the next test shows.
        assert np.abs(rendered - truth).max() < (6e-3 if blur_px < 0.5 else 1.5e-3)


@pytest.mark.parametrize("correlation", [0.0, 0.1, -0.29, 0.31, -0.74, 0.76, 0.95])
def test_two_lines_share_what_a_normal_with_their_correlation_has_beyond_both(correlation: float) -> None:
    cdf = scipy.stats.multivariate_normal(cov=np.array([[1.0, correlation], [correlation, 1.0]])).cdf
    for a, b in ((0.0, 0.0), (0.7, -1.2), (-2.0, -0.3), (4.5, 0.1)):
        both = bivariate_excess(a, b, correlation) + normal_share(a) * normal_share(b)
        assert both == pytest.approx(cdf([a, b]), abs=1e-7)
    assert normal_share(1.3) == pytest.approx(scipy.special.ndtr(1.3), abs=1e-15)
    assert [normal_share(limit) for limit in (-6.1, 6.1)] == pytest.approx([0.0, 1.0], abs=1e-9)


def test_pixels_are_weighted_means_of_their_samples() -> None:
    rng = np.random.default_rng(3)
    samples, kernel = rng.random((23, 31), dtype=np.float32), rng.random(7, dtype=np.float32)
    kernel /= kernel.sum()
    windows = np.lib.stride_tricks.sliding_window_view(samples, (7, 7))[::2, ::2]
    means = np.empty(windows.shape[:2], dtype=np.float32)
    pixel_means(samples, kernel, 2, means)
    np.testing.assert_allclose(means, np.einsum("hwij,i,j->hw", windows, kernel, kernel), atol=1e-6)
    pixel_means(np.full_like(samples, 0.25), kernel, 2, means)
    np.testing.assert_array_equal(means, 0.25)


@pytest.mark.parametrize(
    ("tilt_deg", "blur_px"),
    [
        pytest.param(tilt_deg, blur_px, marks=[] if (tilt_deg, blur_px) == (30.0, 1.0) else pytest.mark.slow)
        for tilt_deg in (0.0, 30.0, 60.0)
        for blur_px in (0.5, 1.0, 2.0)
    ],
)
def test_corners_and_edges_stand_to_a_ten_thousandth_of_a_pixel(tilt_deg: float, blur_px: float) -> None:
    """What differs from the image made the long way, read as a shift of the image, is below 1e-4 px.

    The shift d that explains a difference best is the solution of Σ g gᵀ d = Σ g (truth - rendered).
    """
    camera = Camera(2320.0, 2320.0, 318.2, 241.7, k1=-0.1, k2=0.05)
    target = TargetSpec("chessboard", 4, 3, pitch_mm=20.0)
    turned = so3_exp(math.radians(tilt_deg) * np.array([0.8, 0.6, 0.0])) @ so3_exp(np.array([0.0, 0.0, 0.2]))
    middle = transform(np.eye(3), -np.array([30.0, 20.0, 0.0]))
    T_camera_target = compose(transform(turned, np.array([35.0, 20.0, 560.0])), middle)
    scene = Scene(target, camera, T_camera_target, width_px=760, height_px=560, blur_px=blur_px, light=PLAIN)
    levels = render_levels(scene).astype(np.float64)
    for window in windows_around(scene, scene.points_px[[0, 6, 11]], 12):
        truth = supersampled(scene, window)
        difference = truth - levels[window[1] : window[3], window[0] : window[2]]
        gradient = np.stack([g.ravel() for g in np.gradient(truth)[::-1]])
        shift = np.linalg.solve(gradient @ gradient.T, gradient @ difference.ravel())
        assert np.abs(shift).max() < 1e-4


def test_colours_of_the_squares() -> None:
    """The square diagonally beyond grid point (0, 0) is black, its neighbours are white, and so on."""
    scene = small_scene(T_camera_target=pose(10.0, 20.0))
    image = render_levels(scene)
    pitch = TARGET.pitch_mm
    for i in range(-1, TARGET.columns):
        for j in range(-1, TARGET.rows):
            centre = transform_points(
                scene.T_camera_target, np.array([[(i + 0.5) * pitch, (j + 0.5) * pitch, 0.0]])
            )
            u, v = np.rint(project(centre, CAMERA)[0]).astype(int)
            assert image[v, u] == pytest.approx(0.0 if (i + j) % 2 == 0 else 1.0, abs=1e-3)


def test_a_seen_point_lies_where_the_scene_says() -> None:
    scene = small_scene()
    expected = project(transform_points(scene.T_camera_target, TARGET.points_target()), CAMERA)
    np.testing.assert_array_equal(scene.points_px, expected)
    np.testing.assert_array_equal(scene.grid_points.points_px, expected)


def test_noise_has_its_level_and_follows_the_seed() -> None:
    scene = small_scene(light=Light(60.0, 180.0), noise_levels=4.0, seed=5)
    quiet = dataclasses.replace(scene, noise_levels=0.0)
    noise = render(scene).astype(float) - render_levels(quiet)
    # rounding adds 1/12; the standard deviation of n = 19200 values is known to 4/√(2n) = .02
    assert abs(noise.std() - math.sqrt(16.0 + 1.0 / 12.0)) < 4 * 0.021
    assert abs(noise.mean()) < 4 * 0.03
    np.testing.assert_array_equal(render(scene), render(scene))
    assert np.any(render(scene) != render(dataclasses.replace(scene, seed=6)))


def test_16_bit_is_the_same_image_finer() -> None:
    scene = small_scene(light=Light(60.0, 180.0))
    deep = render(dataclasses.replace(scene, bit_depth=16))
    assert deep.dtype == np.uint16
    np.testing.assert_allclose(deep / 257.0, render_levels(scene), atol=0.5 / 257.0 + 1e-4)


def test_light_falls_off_and_slopes() -> None:
    light = Light(0.0, 100.0, gradient=(0.2, 0.0), vignetting=0.3)
    image = render_levels(small_scene(light=light, quiet_zone=20.0, T_camera_target=pose(0.0, 0.0, 900.0)))
    even = render_levels(
        small_scene(light=Light(0.0, 100.0), quiet_zone=20.0, T_camera_target=pose(0.0, 0.0, 900.0))
    )
    factor = image / even
    assert factor[60, 159] > factor[60, 0] * 1.3
    assert factor[0, 80] < factor[20, 80]
    assert factor[0, 0] == pytest.approx(0.8 * 0.7, abs=0.01)


def test_sheet_beyond_the_image_and_in_a_corner() -> None:
    for shift in ([60.0, 40.0, 0.0], [-400.0, 0.0, 0.0]):
        scene = small_scene(T_camera_target=compose(transform(np.eye(3), np.array(shift)), pose(20.0, 0.0)))
        image = render_levels(scene)
        assert image.shape == (120, 160)
        assert np.all(np.isfinite(image))


def test_refusals() -> None:
    with pytest.raises(InvalidArgument, match="behind"):
        render(small_scene(T_camera_target=pose(88.0, 0.0, 20.0)))
    with pytest.raises(InvalidArgument):
        small_scene(bit_depth=12)
    with pytest.raises(InvalidArgument):
        small_scene(blur_px=0.0)
    with pytest.raises(InvalidTarget):
        render(small_scene(target=TargetSpec("aprilgrid", 5, 4, 10.0)))


def test_standard_scene_has_clutter_and_the_whole_board() -> None:
    scene = standard_scene(standard_target(9, 6), 3)
    image = render(scene)
    assert image.shape == (2050, 2448)
    assert image.dtype == np.uint8
    assert np.std(image[:, :200].astype(float)) > 8.0
    assert np.all(scene.points_px > 4.0)
    assert np.all(scene.points_px < np.array([2443.0, 2045.0]))
