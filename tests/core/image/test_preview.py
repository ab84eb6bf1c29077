"""Reduced images: their size, their place, dark ones, and damaged files."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from core.errors import ImageTooManyPixels, UndecodableImage
from core.image import decode_preview
from tests.support.image.images import encode


def ramp(width: int = 640, height: int = 480) -> np.ndarray:
    """Return an image that is bright at the right and at the bottom."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    return np.asarray((40 + 90 * u / width + 120 * v / height).astype(np.uint8))


@pytest.mark.parametrize("ending", [".jpg", ".png", ".bmp", ".tiff"])
@pytest.mark.parametrize("side", [40, 160, 2000])
def test_a_preview_is_the_image_reduced(ending: str, side: int) -> None:
    image = ramp()
    found = decode_preview(encode(ending, image), longest_side_px=side)
    width = min(side, 640)
    assert found.grey.shape == (round(width * 0.75), width)
    assert (found.image_width_px, found.image_height_px) == (640, 480)
    assert (found.brightening, found.is_whole) == (1.0, True)
    expected = cv2.resize(image, found.grey.shape[::-1], interpolation=cv2.INTER_AREA)
    assert np.abs(found.grey.astype(int) - expected).max() <= 4


@pytest.mark.parametrize("levels", [16, 257])
def test_sixteen_bits_are_shown_in_eight(levels: int) -> None:
    found = decode_preview(encode(".tiff", ramp().astype(np.uint16) * levels), longest_side_px=640)
    assert found.grey.dtype == np.uint8
    assert np.percentile(found.grey, 99) > 200
    assert (found.brightening > 10.0) == (levels == 16)


def test_a_dark_image_is_brightened_and_says_so() -> None:
    found = decode_preview(encode(".png", ramp() // 20), longest_side_px=640)
    assert np.percentile(found.grey, 99) > 200
    assert found.brightening > 10.0
    assert decode_preview(encode(".png", 0 * ramp()), longest_side_px=64).grey.max() == 0


@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_of_a_file_that_was_cut_the_beginning_is_shown(ending: str) -> None:
    image = ramp()
    noisy = np.clip(image + np.random.default_rng(1).normal(0.0, 8.0, image.shape), 0, 255).astype(np.uint8)
    data = encode(ending, noisy)
    found = decode_preview(data[: len(data) // 2], longest_side_px=640)
    assert not found.is_whole
    top = found.grey[:150].astype(float)
    assert abs(top.mean() - noisy[:150].mean()) < 3.0
    assert np.corrcoef(top.ravel(), noisy[:150].ravel().astype(float))[0, 1] > 0.9
    assert found.grey[-50:].std() == 0.0


def test_what_holds_no_pixel_and_what_is_too_large_is_refused() -> None:
    data = encode(".png", ramp())
    with pytest.raises(ImageTooManyPixels):
        decode_preview(data, longest_side_px=64, max_pixels=1000)
    with pytest.raises(UndecodableImage):
        decode_preview(data[:20], longest_side_px=64)
    with pytest.raises(UndecodableImage):
        decode_preview(encode(".tiff", ramp())[:2000], longest_side_px=64)
