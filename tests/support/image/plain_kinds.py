"""Files of the kinds decoded without OpenCV: grey values to write, our readers, and what OpenCV makes of the same."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from core.image import decode, png_pixels, read_header
from tests.support.image.image_encoders import filtered, png

FLAGS = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
SIZES = [(1, 1), (1, 37), (37, 1), (2, 2), (3, 5), (17, 23), (64, 255), (40, 1021)]


def by_opencv(data: bytes) -> np.ndarray | None:
    return cv2.imdecode(np.frombuffer(data, np.uint8), FLAGS)


def noise(height: int, width: int, dtype: type = np.uint8, seed: int = 3) -> np.ndarray:
    return np.random.default_rng([seed, height, width]).integers(
        0, np.iinfo(dtype).max + 1, (height, width), dtype=dtype
    )


def sample_image(height: int, width: int, dtype: type = np.uint8) -> np.ndarray:
    """Return shading with some noise: compresses, and every branch of every predictor is taken."""
    y, x = np.mgrid[:height, :width]
    values = (
        0.5 + 0.3 * np.sin(x / 9.0) * np.cos(y / 7.0) + 0.02 * np.random.default_rng(5).normal(size=x.shape)
    )
    return np.round(values * np.iinfo(dtype).max).clip(0, np.iinfo(dtype).max).astype(dtype)


def check_same(data: bytes, truth: np.ndarray, read: Callable[[bytes], np.ndarray | None]) -> None:
    """Compare what this kind's reader makes of a file with the truth and with OpenCV."""
    plain = read(data)
    assert plain is not None
    assert plain.dtype == truth.dtype == plain.dtype.newbyteorder("=")
    assert plain.flags.c_contiguous
    assert plain.flags.writeable
    np.testing.assert_array_equal(plain, truth)
    np.testing.assert_array_equal(decode(data), truth)
    np.testing.assert_array_equal(by_opencv(data), truth)


def read_png(data: bytes) -> np.ndarray | None:
    return png_pixels.read_plain(memoryview(data), read_header(data))


def grey_png(truth: np.ndarray, kinds: np.ndarray | list[int], **more: object) -> bytes:
    height, width = truth.shape
    return png(0, 8 * truth.dtype.itemsize, filtered(truth, list(kinds)), width, height, **more)
