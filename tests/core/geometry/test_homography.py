"""The plane-to-image homography."""

from __future__ import annotations

import numpy as np
import pytest

from core.errors import DegenerateGeometry
from core.geometry.homography import (
    estimate_homography,
    find_homography,
    map_in_front,
    map_points,
    normalising_transform,
    transform_products,
)

PLANE = np.stack(np.meshgrid(np.arange(7.0), np.arange(5.0)), axis=-1).reshape(-1, 2) * 25.0
TRUE = np.array([[3.1, 0.2, 400.0], [-0.3, 2.9, 300.0], [4e-4, -2e-4, 1.0]])


def test_exact_points_give_the_exact_homography() -> None:
    H = estimate_homography(PLANE, map_points(TRUE, PLANE))
    np.testing.assert_allclose(H / H[2, 2], TRUE, rtol=1e-6, atol=1e-9)


def test_units_do_not_matter() -> None:
    px = map_points(TRUE, PLANE)
    metres = estimate_homography(PLANE * 1e-3, px)
    np.testing.assert_allclose(map_points(metres, PLANE * 1e-3), px, atol=1e-6)


def test_it_is_scaled_to_positive_depths() -> None:
    H = estimate_homography(PLANE, map_points(TRUE, PLANE))
    assert np.all(PLANE @ H[2, :2] + H[2, 2] > 0)


def test_normalised_points_have_mean_zero_and_rms_root_two() -> None:
    N = normalising_transform(PLANE)
    normalised = PLANE * N[0, 0] + N[:2, 2]
    np.testing.assert_allclose(normalised.mean(axis=0), 0.0, atol=1e-12)
    assert np.mean(np.sum(normalised**2, axis=1)) == pytest.approx(2.0)


@pytest.mark.parametrize(
    "plane",
    [PLANE[:3], np.stack([np.arange(9.0), 2 * np.arange(9.0)], axis=1), np.zeros((8, 2))],
    ids=["three points", "one line", "one spot"],
)
def test_what_is_no_plane_is_degenerate(plane: np.ndarray) -> None:
    px = map_points(TRUE, plane)
    with pytest.raises(DegenerateGeometry):
        estimate_homography(plane, px)


def test_products_are_those_of_the_transforms_rows() -> None:
    px = map_points(TRUE, PLANE) + np.random.default_rng(0).normal(0.0, 0.3, PLANE.shape)
    N_plane, N_px = normalising_transform(PLANE), normalising_transform(px)
    p = np.column_stack([PLANE, np.ones(len(PLANE))]) @ N_plane.T
    u, v = (px * N_px[0, 0] + N_px[:2, 2]).T[..., None]
    A = np.vstack([np.hstack([p, 0 * p, -u * p]), np.hstack([0 * p, p, -v * p])])
    found = transform_products(np.ascontiguousarray(p[:, :2]), px * N_px[0, 0] + N_px[:2, 2], np.ones(len(p)))
    np.testing.assert_allclose(np.tril(found), np.tril(A.T @ A), atol=1e-9)


def test_points_on_a_line_have_no_homography() -> None:
    line = np.stack([np.arange(6.0), 2.0 * np.arange(6.0)], axis=1)
    assert find_homography(line, line) is None
    np.testing.assert_array_equal(
        find_homography(PLANE, map_points(TRUE, PLANE)), estimate_homography(PLANE, map_points(TRUE, PLANE))
    )


def test_points_behind_the_camera_are_mapped_nowhere() -> None:
    H = np.array([[1.0, 0.0, 3.0], [0.0, 1.0, 0.0], [0.0, -0.5, 1.0]])
    points = np.array([[1.0, 1.0], [4.0, 0.0], [1.0, 2.5]])
    seen = map_in_front(H, points)
    np.testing.assert_array_equal(seen[:2], map_points(H, points[:2]))
    assert np.isnan(seen[2]).all()
