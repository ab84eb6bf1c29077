"""How well an image was taken: blur, motion, light and tilt against what was rendered."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from core import GridPoints, TargetSpec
from core.targets.image_quality.advice import advise
from core.targets.image_quality.assessment import assess_capture, with_tilt
from core.targets.image_quality.edge_kernel import BINS_PER_PX, REACH_PX, average_profiles
from core.targets.quality_result import CaptureQuality
from tests.support.image.view_flaws import trail
from tests.support.simulation.renders import render_levels
from tests.support.simulation.scenes import standard_scene

TARGETS = {
    "chessboard": TargetSpec("chessboard", 9, 6, 33.0),
    "charuco": TargetSpec("charuco", 9, 6, 33.0, 20.0, "DICT_5X5_100"),
    "aprilgrid": TargetSpec("aprilgrid", 6, 4, 50.0, 38.0),
    "circles": TargetSpec("circles", 9, 6, 33.0),
    "asymmetric_circles": TargetSpec("asymmetric_circles", 5, 9, 28.0),
}
# A chessboard's edges are straight, those of dots are not; the others are squares with marks in them.
SOME_TARGETS = [
    pytest.param(kind, marks=[] if kind in ("chessboard", "circles") else pytest.mark.slow)
    for kind in TARGETS
]
GAUSSIAN_RISE = 2.563
PIXEL = 1.0 / 12.0  # variance of a pixel's own square, px²


def taken(
    kind: str,
    seed: int,
    *,
    blur_px: float,
    tilt: float,
    motion_px: float = 0.0,
    direction: float = 0.0,
    gain: float = 1.0,
) -> tuple[np.ndarray, GridPoints]:
    """Return an image, moved while it was exposed, and the true grid points."""
    scene = standard_scene(TARGETS[kind], seed, tilt=tilt, blur_px=blur_px, noise_levels=0.0, clutter=0.0)
    levels = render_levels(scene)
    if motion_px > 0.0:
        levels = cv2.filter2D(levels, -1, trail(motion_px, direction), borderType=cv2.BORDER_REPLICATE)
    noise = 3.0 * np.random.default_rng(seed).standard_normal(levels.shape)
    return np.clip(np.rint(gain * levels + noise), 0, 255).astype(np.uint8), scene.grid_points


@pytest.mark.parametrize("kind", SOME_TARGETS)
@pytest.mark.parametrize(("seed", "blur_px"), [(1, 0.8), pytest.param(2, 1.5, marks=pytest.mark.slow)])
def test_edges_are_as_wide_as_lens_and_pixel_make_them(kind: str, seed: int, blur_px: float) -> None:
    image, points = taken(kind, seed, blur_px=blur_px, tilt=0.5)
    quality = assess_capture(image, points)
    # The profile's own interpolation adds up to 1/12 px² and more; 10 % beyond that for curved and sampled edges.
    sharpest, widest = (GAUSSIAN_RISE * math.sqrt(blur_px**2 + more) for more in (PIXEL, 3.0 * PIXEL))
    assert quality.edge_width_px is not None
    assert 0.95 * sharpest < quality.edge_width_px < 1.1 * widest
    assert quality.motion_blur_direction is None
    assert not {"motion_blur", "overexposed", "low_contrast", "underexposed"} & {
        a.code for a in quality.advice
    }


@pytest.mark.parametrize("kind", SOME_TARGETS)
@pytest.mark.parametrize(
    ("seed", "motion_px", "degrees"), [(3, 6.0, 30.0), pytest.param(5, 8.0, 80.0, marks=pytest.mark.slow)]
)
def test_motion_has_its_length_and_direction(kind: str, seed: int, motion_px: float, degrees: float) -> None:
    image, points = taken(
        kind, seed, blur_px=1.0, tilt=0.3, motion_px=motion_px, direction=math.radians(degrees)
    )
    quality = assess_capture(image, points)
    assert quality.motion_blur_px == pytest.approx(motion_px, rel=0.2)
    assert quality.motion_blur_direction is not None
    off = (math.degrees(quality.motion_blur_direction) - degrees + 90.0) % 180.0 - 90.0
    assert abs(off) < 8.0
    assert quality.advice[0].code == "motion_blur"


def test_light_that_is_too_bright_is_said_with_its_share() -> None:
    image, points = taken("chessboard", 6, blur_px=1.0, tilt=0.4, gain=1.6)
    inside = cv2.fillConvexPoly(
        np.zeros(image.shape, np.uint8),
        cv2.convexHull(points.points_px.astype(np.int32)).reshape(-1, 1, 2),
        1,
    ).astype(bool)
    share = float((image[inside] == 255).mean()) * 2.0  # half of the board is white
    quality = assess_capture(image, points)
    assert 0.1 < share < 1.0
    assert quality.saturated_fraction == pytest.approx(share, abs=0.15)
    assert quality.advice[0].code == "overexposed"


def test_too_little_light() -> None:
    image, points = taken("charuco", 7, blur_px=1.0, tilt=0.4, gain=0.2)
    quality = assess_capture(image, points)
    assert quality.contrast is not None
    assert quality.contrast < 0.15
    assert "low_contrast" in [warning.code for warning in quality.advice]


def test_sixteen_bit_images_are_judged_the_same() -> None:
    image, points = taken("circles", 8, blur_px=1.0, tilt=0.4)
    eight, sixteen = assess_capture(image, points), assess_capture(image.astype(np.uint16) * 257, points)
    assert sixteen.edge_width_px == pytest.approx(eight.edge_width_px, rel=1e-6)
    assert sixteen.contrast == pytest.approx(eight.contrast, rel=1e-6)


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("chessboard", 12),
        pytest.param("chessboard", 13, marks=pytest.mark.slow),
        pytest.param("circles", 14, marks=pytest.mark.slow),
    ],
)
def test_a_steep_target_at_rest_did_not_move(kind: str, seed: int) -> None:
    """Squares short in one direction leave edges too little room; what they seem to be is not taken for motion."""
    image, points = taken(kind, seed, blur_px=1.2, tilt=math.radians(69.0))
    quality = assess_capture(image, points)
    assert quality.motion_blur_direction is None
    assert "motion_blur" not in {warning.code for warning in quality.advice}


@pytest.mark.parametrize(
    ("kind", "columns", "degrees", "seeds"),
    [
        ("chessboard", 9, 65.0, (21,)),
        pytest.param("chessboard", 30, 69.0, (20, 21), marks=pytest.mark.slow),
        pytest.param("charuco", 18, 66.0, (20, 21), marks=pytest.mark.slow),
    ],
)
def test_steep_squares_look_no_sharper_than_they_are(
    kind: str, columns: int, degrees: float, seeds: tuple[int, ...]
) -> None:
    """Profiles leave leaning squares at the sides next to them: widths came out at half, or are not reported."""
    side = 300.0 / columns
    markers = (0.5 * side, "DICT_5X5_1000") if kind == "charuco" else ()
    target = TargetSpec(kind, columns, 2 * columns // 3, side, *markers)
    sharpest, widest = (GAUSSIAN_RISE * math.sqrt(1.2**2 + more) for more in (PIXEL, 3.0 * PIXEL))
    widths = []
    for seed in seeds:
        scene = standard_scene(
            target, seed, tilt=math.radians(degrees), blur_px=1.2, noise_levels=0.0, clutter=0.0
        )
        image = np.clip(np.rint(render_levels(scene)), 0, 255).astype(np.uint8)
        widths.append(assess_capture(image, scene.grid_points).edge_width_px)
    assert widths[0] is not None
    assert all(width is None or 0.95 * sharpest < width < 1.1 * widest for width in widths)


def test_blur_that_fills_the_squares_is_not_called_sharp() -> None:
    dense = TargetSpec("chessboard", 40, 30, 7.5)
    scene = standard_scene(dense, 15, tilt=0.4, blur_px=4.0, noise_levels=0.0, clutter=0.0)
    levels = render_levels(scene)
    quality = assess_capture(np.clip(np.rint(levels), 0, 255).astype(np.uint8), scene.grid_points)
    assert quality.edge_width_px is None
    assert quality.contrast is None
    assert quality.advice[0].code == "sharpness_not_measurable"
    assert with_tilt(quality, 0.5).advice[0].code == "sharpness_not_measurable"


@pytest.mark.parametrize("degrees", [3.0, pytest.param(30.0, marks=pytest.mark.slow), 66.0])
def test_tilt_is_near_even_for_another_lens(degrees: float) -> None:
    image, points = taken("chessboard", 9, blur_px=1.0, tilt=math.radians(degrees))
    quality = assess_capture(image, points)
    assert quality.tilt is not None
    assert math.degrees(quality.tilt) == pytest.approx(degrees, abs=4.0)
    codes = {warning.code for warning in quality.advice}
    assert ("tilt_too_small" in codes) == (degrees < 15.0)
    assert ("tilt_too_large" in codes) == (degrees > 60.0)
    assert "tilt_too_large" in {warning.code for warning in with_tilt(quality, math.radians(70.0)).advice}


def test_an_image_that_shows_nothing_says_so() -> None:
    """A blank image where points are claimed: no edge anywhere, and nothing made up."""
    _, points = taken("chessboard", 10, blur_px=1.0, tilt=0.3)
    quality = assess_capture(np.full((2050, 2448), 90, np.uint8), points)
    assert quality.edge_width_px is None
    assert quality.motion_blur_px is None
    assert quality.contrast is None
    assert quality.saturated_fraction is None


def test_the_most_worthwhile_comes_first_and_a_good_image_needs_nothing() -> None:
    good = CaptureQuality(2.7, 0.4, None, 0.0, 0.0, 0.6, 0.4, math.radians(30.0), ())
    assert advise(good) == ()
    poor = CaptureQuality(9.0, 7.0, 0.2, 0.3, 0.5, 0.1, 0.02, 0.0, ())
    assert [warning.code for warning in advise(poor)] == [
        "overexposed",
        "motion_blur",
        "blurred",
        "low_contrast",
        "underexposed",
        "tilt_too_small",
        "low_image_coverage",
    ]
    assert all(warning.advice for warning in advise(poor))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_average_profiles_are_those_of_numpy(dtype: type) -> None:
    """The kernel's average is that of profiles taken one by one with numpy's interpolation."""
    rng = np.random.default_rng(11)
    v, u = np.mgrid[0:80, 0:90]
    image = (60 + 120 / (1 + np.exp(-(u - 0.3 * v - 30.0))) + rng.normal(0, 1, u.shape)).astype(dtype)
    along = np.array([1.0, -0.3]) / math.hypot(1.0, 0.3)
    middle = np.array([[30 + 0.3 * y + rng.uniform(-2, 2), y] for y in rng.uniform(14, 60, 12)])
    across = np.where(rng.random(12)[:, None] < 0.5, along, -along)
    half = rng.uniform(6.0, 10.0, 12)
    family = np.arange(12) % 2
    averages, counts, ends, saturated, clipped = average_profiles(
        image, middle, across, half, family, 3, 20.0, 179.0
    )
    bins = 2 * REACH_PX * BINS_PER_PX
    gathered: list[list[list[float]]] = [[[] for _ in range(bins)] for _ in range(3)]
    bright_ends, dark_ends = [], []
    for k in range(12):
        steps = int(half[k] / 0.5)
        s = np.arange(-steps, steps + 1) * 0.5
        places = (middle[k] + s[:, None] * across[k]).astype(np.float64)
        cell = np.floor(places).astype(int)
        a, b = (places - cell).T
        x, y = cell.T
        p = image.astype(float)
        values = (1 - b) * ((1 - a) * p[y, x] + a * p[y, x + 1]) + b * (
            (1 - a) * p[y + 1, x] + a * p[y + 1, x + 1]
        )
        quarter = max(1, len(s) // 8)
        first, last = values[:quarter].mean(), values[-quarter:].mean()
        np.testing.assert_allclose(ends[k], sorted((first, last)))
        level = values - 0.5 * (first + last)
        (crossings,) = np.nonzero((level[:-1] < 0) != (level[1:] < 0))
        at = min((s[i] + 0.5 * level[i] / (level[i] - level[i + 1]) for i in crossings), key=abs)
        share = (values - min(first, last)) / abs(last - first)
        for place, value in zip(np.sign(last - first) * (s - at), share, strict=True):
            gathered[k % 2][math.floor(place * BINS_PER_PX) + bins // 2].append(value)
        low, high = (
            (values[:quarter], values[-quarter:]) if last > first else (values[-quarter:], values[:quarter])
        )
        dark_ends.extend(low)
        bright_ends.extend(high)
    for number in range(3):
        np.testing.assert_array_equal(counts[number], [len(values) for values in gathered[number]])
        expected = [np.mean(values) if values else np.nan for values in gathered[number]]
        np.testing.assert_allclose(averages[number], expected, rtol=1e-12)
    assert saturated == pytest.approx(np.mean(np.array(bright_ends) >= 179.0))
    assert clipped == np.mean(np.array(dark_ends) <= 0.0)


def test_profiles_that_leave_the_image_are_excluded() -> None:
    image = np.tile(np.repeat([30, 200], 20).astype(np.uint8), (40, 1))
    middle = np.array([[19.5, 20.0], [2.0, 20.0], [19.5, 45.0]])
    across = np.tile([1.0, 0.0], (3, 1))
    _, _, ends, _, _ = average_profiles(
        image, middle, across, np.full(3, 6.0), np.zeros(3, np.intp), 1, 10.0, 254.0
    )
    np.testing.assert_array_equal(np.isfinite(ends[:, 0]), [True, False, False])
