"""What is said of images that show a board of another kind than the one asked for."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from core import calibrate_image
from core.errors import DetectionError, OriginUnknown, TargetMismatch, TargetNotFound
from core.geometry.camera import Camera
from core.simulation import Scene, random_pose
from core.targets.failure_diagnosis import _searched, look_for
from core.targets.specification import TargetSpec
from tests.support.simulation.renders import render

CAMERA = Camera(1000.0, 1000.0, 503.0, 396.0, k1=-0.1, k2=0.05)
CHESSBOARD = TargetSpec("chessboard", 9, 6, 20.0)
CHARUCO = TargetSpec("charuco", 9, 6, 20.0, 15.0, "DICT_5X5_100")
SMALL_MARKERS = TargetSpec("charuco", 9, 6, 20.0, 11.0, "DICT_4X4_50")
CIRCLES = TargetSpec("circles", 9, 6, 20.0)
STAGGERED = TargetSpec("asymmetric_circles", 4, 11, 20.0)
APRILGRID = TargetSpec("aprilgrid", 4, 4, 40.0, 30.0)


def image_of(target: TargetSpec, seed: int, marks: bool = False) -> np.ndarray:
    rng = np.random.default_rng([seed, 5])
    tilt = math.radians(rng.uniform(0.0, 40.0))
    T = random_pose(target, CAMERA, (1000, 800), tilt, math.radians(180.0), rng)
    return render(Scene(target, CAMERA, T, 1000, 800, noise_levels=2.0, seed=seed, marks=marks))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("shown", "asked", "said"),
    [
        (CHARUCO, CHESSBOARD, "A ChArUco board"),
        (SMALL_MARKERS, STAGGERED, "A ChArUco board"),
        (CHARUCO, CIRCLES, "A ChArUco board"),
        (CHESSBOARD, CHARUCO, "A chessboard of 9 x 6"),
        (CHESSBOARD, STAGGERED, "A chessboard of 9 x 6"),
        (CHESSBOARD, CIRCLES, "A chessboard of 9 x 6"),
        (CHARUCO, STAGGERED, "A ChArUco board"),
        (CHESSBOARD, APRILGRID, "A chessboard of 9 x 6"),
        (CHARUCO, APRILGRID, "A ChArUco board"),
    ],
)
def test_boards_of_another_kind_are_named(shown: TargetSpec, asked: TargetSpec, said: str, seed: int) -> None:
    with pytest.raises(TargetMismatch, match=said) as caught:
        look_for(image_of(shown, seed), asked)
    assert f"of {asked.columns} x {asked.rows} was asked for" in caught.value.detail
    _, file = cv2.imencode(".png", image_of(shown, seed))
    with pytest.raises(TargetMismatch, match=said):
        calibrate_image(file.tobytes(), asked)


@pytest.mark.parametrize("seed", range(1, 5))
def test_the_black_pixels_of_dithered_squares_are_no_markers(seed: int) -> None:
    """Of one bit: of the light squares a quarter of the pixels is black."""
    grey = image_of(CHESSBOARD, seed).astype(np.float64)
    light = np.interp(grey, [grey.min(), grey.max()], [5.0, 190.0])
    bayer = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]])
    image = np.where(light > np.tile(16.0 * bayer + 8.0, (200, 250)), 255, 0)
    with pytest.raises(DetectionError) as caught:
        look_for(image.astype(np.uint8), replace(CHESSBOARD, columns=7))
    assert "ChArUco" not in caught.value.detail


@pytest.mark.parametrize("asked", [CHESSBOARD, CHARUCO, CIRCLES, STAGGERED, APRILGRID])
def test_without_any_board_none_is_named(asked: TargetSpec) -> None:
    rng = np.random.default_rng(7)
    for levels in (
        np.full((800, 1000), 128.0),
        cv2.GaussianBlur(rng.normal(128.0, 400.0, (800, 1000)), (0, 0), 3.0),
        np.where((np.indices((800, 1000)) // 3).sum(axis=0) % 2 == 0, 60.0, 200.0),
    ):
        with pytest.raises(TargetNotFound):
            look_for(np.clip(levels, 0, 255).astype(np.uint8), asked)


@pytest.mark.parametrize("asked", [CHARUCO, CIRCLES, APRILGRID])
@pytest.mark.parametrize("shown", [CHARUCO, SMALL_MARKERS])
def test_a_board_white_on_black_is_named_as_such(shown: TargetSpec, asked: TargetSpec) -> None:
    with pytest.raises(TargetMismatch, match=r"A ChArUco board of .*, white on black, is in view") as caught:
        look_for(255 - image_of(shown, 1), asked)
    assert "inverted" in caught.value.advice


@pytest.mark.parametrize("seed", range(4))
def test_an_aprilgrid_or_plain_squares_are_no_board_white_on_black(seed: int) -> None:
    for shown in (APRILGRID, CHESSBOARD):
        for image in (image_of(shown, seed), 255 - image_of(shown, seed)):
            with pytest.raises(DetectionError) as caught:
                look_for(image, CHARUCO)
            assert "white on black" not in caught.value.detail


@pytest.mark.parametrize("seed", range(2))
def test_an_aprilgrid_white_on_black_is_named_as_such(seed: int) -> None:
    image = image_of(APRILGRID, seed)
    for asked in (APRILGRID, TargetSpec("aprilgrid", 5, 4, APRILGRID.pitch_mm, APRILGRID.marker_mm)):
        with pytest.raises(TargetMismatch, match="white on black") as caught:
            look_for(255 - image, asked)
        assert "inverted" in caught.value.advice
    with pytest.raises(TargetNotFound):
        look_for(255 - image_of(CIRCLES, seed), APRILGRID)


@pytest.mark.parametrize(("seed", "blur_px"), [(1, 4.0), (2, 5.0), (2, 6.0), (3, 3.0), (3, 5.0)])
def test_a_charuco_board_out_of_focus_is_not_taken_for_a_chessboard(seed: int, blur_px: float) -> None:
    """Its markers are grey spots then, which nobody reads and everybody sees."""
    blurred = cv2.GaussianBlur(image_of(SMALL_MARKERS, seed), (0, 0), blur_px)
    with pytest.raises(TargetNotFound) as caught:
        look_for(blurred, SMALL_MARKERS)
    assert "sharp" in str(caught.value.advice)
    with pytest.raises(TargetMismatch, match="A ChArUco board of at least 9 x 6"):
        look_for(blurred, CIRCLES)
    with pytest.raises(TargetMismatch, match="A chessboard of 9 x 6"):
        look_for(cv2.GaussianBlur(image_of(CHESSBOARD, seed), (0, 0), blur_px), SMALL_MARKERS)


@pytest.mark.parametrize(("seed", "blur_px"), [(1, 3.0), (4, 2.0), (5, 3.0), (7, 5.0)])
def test_a_few_markers_read_by_chance_do_not_make_the_board_another_one(seed: int, blur_px: float) -> None:
    """Three of 35 frames read as a marker of 4 x 4 cells, in no order."""
    with pytest.raises(TargetNotFound, match="hardly any of") as caught:
        look_for(cv2.GaussianBlur(image_of(SMALL_MARKERS, seed), (0, 0), blur_px), SMALL_MARKERS)
    assert "sharp" in str(caught.value.advice)


def test_where_no_marker_is_left_to_be_seen_focus_is_advised() -> None:
    """Markers of three quarters of a square leave no white around them then."""
    blurred = cv2.GaussianBlur(image_of(CHARUCO, 3), (0, 0), 4.0)
    with pytest.raises(TargetMismatch, match="A chessboard of 9 x 6") as caught:
        look_for(blurred, CHARUCO)
    assert "focus" in str(caught.value.advice)
    with pytest.raises(TargetMismatch) as caught:
        look_for(blurred, CIRCLES)
    assert "focus" not in str(caught.value.advice)


@pytest.mark.parametrize("marker_mm", [17.8, 18.0, 19.0])
def test_where_hardly_a_marker_is_read_as_its_size_is_wrong_the_size_is_named(marker_mm: float) -> None:
    """With 17.8 mm in place of 15 two markers are read, with more none."""
    with pytest.raises(TargetNotFound) as caught:
        look_for(image_of(CHARUCO, 3), replace(CHARUCO, marker_mm=marker_mm))
    assert "marker_mm" in str(caught.value.advice)


@pytest.mark.parametrize("scale", [3, 4])
def test_boards_in_large_images_are_named(scale: int) -> None:
    for shown, said in ((CHARUCO, "A ChArUco board"), (CHESSBOARD, "A chessboard of 9 x 6")):
        large = cv2.resize(image_of(shown, 2), None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        with pytest.raises(TargetMismatch, match=said):
            look_for(large, CIRCLES)


@pytest.mark.parametrize("square_px", [7, 9])
def test_fine_texture_is_searched_at_a_size_that_bounds_its_lattices(square_px: int) -> None:
    texture = np.where((np.indices((2400, 3200)) // square_px).sum(axis=0) % 2 == 0, 20, 220).astype(np.uint8)
    searched = _searched(texture)
    assert max(searched.shape) <= 1400
    small = _searched(np.ascontiguousarray(texture[:1050, :1400]))
    assert max(small.shape) < 1400  # more corners than a board has
    with pytest.raises(TargetNotFound):
        look_for(texture, CHARUCO)


def test_marked_squares_are_no_markers() -> None:
    """A chessboard with marks, of another size: named by its size, as ever."""
    with pytest.raises(DetectionError) as caught:
        look_for(image_of(CHESSBOARD, 3, marks=True), TargetSpec("chessboard", 7, 5, 20.0))
    assert "ChArUco" not in caught.value.detail
    assert isinstance(caught.value, TargetMismatch)


def test_the_board_asked_for_is_found_as_ever() -> None:
    for target in (CHESSBOARD, CHARUCO, CIRCLES, STAGGERED, APRILGRID):
        assert len(look_for(image_of(target, 4), target)) > 0.9 * target.size


@pytest.mark.parametrize("seed", range(4))
def test_of_other_dictionaries_the_markers_decide(seed: int) -> None:
    """Their squares are not those of a chessboard, nor is what lies within a marker."""
    shown = TargetSpec("charuco", 7, 5, 24.0, 16.8, "DICT_5X5_100")
    with pytest.raises(TargetNotFound):
        look_for(image_of(shown, seed), TargetSpec("charuco", 7, 5, 24.0, 16.8, "DICT_4X4_100"))


def test_of_the_board_asked_for_but_hidden_nothing_else_is_said() -> None:
    shown = image_of(CHESSBOARD, 6)
    shown[:, 350:650] = 90
    with pytest.raises(OriginUnknown):
        look_for(shown, CHESSBOARD)
