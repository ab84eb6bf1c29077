"""Kernels of the grid's smooth map against plain numpy: orthonormal polynomials, and derivatives by differences."""

from __future__ import annotations

import numpy as np

from core.geometry import normalised_homography
from core.targets.subpixel.degree_selection import orthonormal
from core.targets.subpixel.smooth_map import _derived, _evaluated


def test_the_orthonormal_basis_is_that_of_householder() -> None:
    rng = np.random.default_rng(1)
    B = np.vander(rng.uniform(-1.5, 1.5, 80), 7, increasing=True)
    Q, R = orthonormal(B)
    np.testing.assert_allclose(Q.T @ Q, np.eye(7), atol=1e-14)
    np.testing.assert_allclose(Q @ R, B, atol=1e-13)
    np.testing.assert_allclose(np.abs(R), np.abs(np.linalg.qr(B)[1]), atol=1e-12)
    Q, R = orthonormal(np.column_stack([B[:, :2], B[:, :1] - 2.0 * B[:, 1:2], B[:, 2:3]]))
    np.testing.assert_array_equal(Q[:, 2], 0.0)
    assert R[2, 2] == 0.0
    np.testing.assert_allclose(np.linalg.norm(Q[:, 3]), 1.0)


def test_a_homography_and_its_polynomials_against_differences() -> None:
    rng = np.random.default_rng(4)
    x, H = rng.uniform(-1.5, 1.5, (40, 2)), np.array([[1.1, 0.2, 0.1], [-0.1, 0.9, 0.2], [0.12, -0.08, 1.0]])
    powers = np.array([(d - j, j) for d in range(6) for j in range(d + 1)])

    def values(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        m = np.column_stack([x, np.ones(len(x))]) @ H.T
        m = m[:, :2] / m[:, 2:]
        return m, m[:, :1] ** powers[:, 0] * m[:, 1:] ** powers[:, 1]

    image, polynomials = _derived(H, x, powers)
    h = 1e-4
    for which, derived in enumerate((image, polynomials)):
        here = values(x)[which]
        np.testing.assert_allclose(derived[0], here, rtol=1e-12, atol=1e-14)
        for axis in range(2):
            step = h * np.eye(2)[axis]
            after, before = values(x + step)[which], values(x - step)[which]
            np.testing.assert_allclose(derived[1 + axis], (after - before) / (2 * h), rtol=1e-5, atol=1e-5)
            np.testing.assert_allclose(
                derived[3 + axis], (after - 2 * here + before) / h**2, rtol=1e-4, atol=1e-3
            )
        corners = [values(x + h * np.array(signs))[which] for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        mixed = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * h**2)
        np.testing.assert_allclose(derived[5], mixed, rtol=1e-4, atol=1e-3)
    found = normalised_homography(x, image[0], np.ones(40))
    np.testing.assert_allclose(found / found[2, 2], H, atol=1e-9)
    c, scales, middle = (
        rng.normal(size=(10, 2)),
        np.array([3.0, 2.0, 2.0, 1.5, 1.5, 1.2]),
        np.array([7.0, -4.0]),
    )
    expected = (image + polynomials[:, :, :10] @ c) * scales[:, None, None]
    expected[0] += middle
    np.testing.assert_allclose(
        _evaluated(image, polynomials, c, scales, middle), expected, rtol=1e-11, atol=1e-11
    )
