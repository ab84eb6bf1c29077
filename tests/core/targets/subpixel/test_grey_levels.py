"""Sampling of grey levels, between pixels and at them."""

from __future__ import annotations

import numpy as np
import pytest

from core.targets.subpixel.sampling import levels_between, nearest_levels


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_levels_between_pixels_are_bilinear_and_those_of_the_border_beyond_it(dtype: type) -> None:
    v, u = np.mgrid[0:6, 0:8]
    image = (10 * u + 4 * v).astype(dtype)
    u_px, v_px = np.array([[2.5, 3.25], [-4.0, 90.0]]), np.array([[1.5, 2.0], [3.0, 5.0]])
    np.testing.assert_allclose(levels_between(image, u_px, v_px), [[31.0, 40.5], [12.0, 90.0]], atol=0.51)


def test_levels_are_sampled_at_more_rows_of_places_than_opencv_takes() -> None:
    image = np.arange(48, dtype=np.uint8).reshape(6, 8)
    u, v = np.full((70_000, 2), 2.0), np.full((70_000, 2), 1.0)
    u[-1], v[40_000] = 3.0, 2.0
    levels = levels_between(image, u, v)
    assert levels[-1, 0] == 11.0
    assert levels[40_000, 1] == 18.0
    assert np.count_nonzero(levels != 10.0) == 4


def test_nearest_levels_are_means_around_the_nearest_pixel() -> None:
    image = np.arange(48, dtype=np.uint8).reshape(6, 8)
    places = np.array([[2.4, 1.6], [0.6, 3.0], [7.0, 5.0], [7.1, 2.0], [np.nan, 1.0]])
    np.testing.assert_array_equal(nearest_levels(image, places), [18.0, 25.0, 47.0, np.nan, np.nan])
    around = nearest_levels(image, places, 1)
    np.testing.assert_array_equal(around, [image[1:4, 1:4].mean(), np.nan, np.nan, np.nan, np.nan])
