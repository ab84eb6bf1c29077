"""The kernels of the refinement, against plain numpy."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy.special import ndtr

from core.jit import Kernel
from core.targets.subpixel import corner_model as model
from core.targets.subpixel.corner_arms import count_strays, sum_arm
from core.targets.subpixel.corner_motion import move_corners
from core.targets.subpixel.corner_step import step_corners
from core.targets.subpixel.smooth_map import grid_basis, grid_shape
from tests.support.compiled_code import compiled_anew
from tests.support.targets.refined_corners import rms, to_8_bit


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
    of_all = np.sum(weight * (grey - np.average(grey, weights=weight)) ** 2) - np.sum(residual**2)
    assert step[model.EXPLAINED] == pytest.approx(of_all, rel=max(0.01, rtol))
    expected = covariance[[0, 0, 1], [0, 1, 1]]
    stated = step[[model.COV_UU, model.COV_UV, model.COV_VV]]
    np.testing.assert_allclose(stated, expected, atol=5e-3 * np.abs(expected).max())


@pytest.mark.parametrize("kernel", [sum_arm, count_strays])
def test_the_loop_over_an_arm_s_pixels_is_vectorised(kernel: Kernel) -> None:
    """A call in the loop prevents that, and a corner takes two and a half times as long."""
    code = compiled_anew(kernel)
    assert not re.search(r"call .*_model_at", code)
    assert re.search(r"fmul [^<]*reassoc[^<]*<\d+ x double>", code)


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
