"""The compiled kernels of a view's fit, against the same in plain numpy."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from core.calibration.residuals.blocks import BLOCK
from core.calibration.residuals.one_view import descend, residuals_with_jacobian
from core.calibration.uncertainty import sum_of_products
from core.geometry.camera import Camera, project_with_jacobian
from core.geometry.se3 import so3_exp
from core.jit import Kernel
from tests.support.compiled_code import compiled_anew

CAMERA = Camera(900.0, 950.0, 640.5, 477.25, -0.21, 0.11, 8e-4, -6e-4, -0.03)
RNG = np.random.default_rng(3)
COUNT = 2 * BLOCK + 11
TARGET = RNG.uniform([-200, -150, -5], [200, 150, 5], (COUNT, 3))
OBSERVED = RNG.uniform(0.0, 1000.0, (COUNT, 2))
ROTATION, TRANSLATION = so3_exp(np.array([0.5, -0.3, 0.2])), np.array([20.0, -10.0, 700.0])


@pytest.mark.parametrize("count", [1, BLOCK, COUNT])
@pytest.mark.parametrize("cameras", [0, 8])
def test_one_pass_gives_the_chain_rules_numbers(cameras: int, count: int) -> None:
    target, observed = TARGET[:count], OBSERVED[:count]
    residuals, jacobian = residuals_with_jacobian(
        target.T.copy(), observed.T.copy(), CAMERA.as_array(), ROTATION, TRANSLATION, cameras
    )
    rotated = target @ ROTATION.T
    pixels, by_camera, by_point = project_with_jacobian(rotated + TRANSLATION, CAMERA)
    # d(exp(w) R x)/dw = w × (R x): the gradient by w is (R x) × gradient by the point.
    by_rotation = np.cross(rotated, by_point.transpose(2, 1, 0).swapaxes(0, 1)).transpose(2, 0, 1)
    np.testing.assert_allclose(residuals, observed.T - pixels, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(
        jacobian, np.concatenate([by_camera[:cameras], by_rotation, by_point]), rtol=1e-9, atol=1e-9
    )


def test_a_point_in_the_cameras_centre_is_no_error() -> None:
    residuals, _ = residuals_with_jacobian(
        np.zeros((3, 1)), np.zeros((2, 1)), CAMERA.as_array(), np.eye(3), np.zeros(3), 8
    )
    assert not np.any(np.isfinite(residuals))


@pytest.mark.parametrize("kernel", [residuals_with_jacobian, descend])
def test_the_loop_over_a_block_s_points_is_vectorised(kernel: Kernel) -> None:
    """Where the compiler does not know how far apart a block's rows are, it is not, and a pooled fit takes longer."""
    assert re.search(r"fdiv .*<\d+ x double>", compiled_anew(kernel))


def test_products_of_chosen_columns() -> None:
    a, b = RNG.normal(size=(4, 30)), RNG.normal(size=(4, 30))
    first, second = RNG.integers(0, 30, 50), RNG.integers(0, 30, 50)
    expected = float(np.vdot(a[:, first], b[:, second]))
    assert math.isclose(sum_of_products(a, b, first, second), expected, rel_tol=1e-12)
