"""The fit of a dot's outline, against plain numpy, scipy and OpenCV."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.targets.circles.blobs import patches
from core.targets.circles.centres.ellipse_model import RESIDUAL, ROWS, TOGETHER, normal, write_equations
from core.targets.circles.centres.ellipse_solver import fit_dot, fit_each, solve_equations
from tests.support.simulation.renders import render
from tests.support.targets.dot_scenes import SYMMETRIC, scene_of


def test_equations_are_those_of_the_model() -> None:
    """The kernel against the model in numpy, with derivatives from differences."""
    rng = np.random.default_rng(3)
    image = rng.uniform(20.0, 200.0, (60, 70))
    shape = np.array([34.3, 28.8, 0.008, 0.002, 0.012, 1.3])
    light = np.array([180.0, 5.0, -3.0, -140.0, 4.0, 2.0])
    reach = 5.5

    def model(
        shape: np.ndarray, light: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        x, y = u - shape[0], v - shape[1]
        mx, my = shape[2] * x + shape[3] * y, shape[3] * x + shape[4] * y
        F, steep = np.sqrt(x * mx + y * my), np.hypot(mx, my)
        a = (1.0 - F) * F / steep
        unit = (shape[2] * shape[4] - shape[3] ** 2) ** 0.25
        P = np.vectorize(lambda z: 0.5 * math.erfc(-z / math.sqrt(2.0)))(a / shape[5])
        xn, yn = x * unit, y * unit
        return light[0] + light[1] * xn + light[2] * yn + (light[3] + light[4] * xn + light[5] * yn) * P, a

    v, u = (a.ravel().astype(float) for a in np.mgrid[0:60, 0:70])
    values, distance = model(shape, light, u, v)
    used = np.abs(distance) <= reach
    N, buffers = np.empty((ROWS, 16)), (np.zeros((ROWS, TOGETHER)), np.empty((3, TOGETHER)))
    count = write_equations(image, shape, light, reach, 1, N, *buffers)
    residual = image.ravel()[used] - values[used]
    assert count == used.sum()
    assert N[RESIDUAL, RESIDUAL] == pytest.approx(np.sum(residual**2))
    assert N[6, 6] == pytest.approx(count)
    assert N[RESIDUAL, 6] == pytest.approx(residual.sum())
    edge = np.abs(distance[used]) < 0.7  # derivatives are those at the edge
    J = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6 * max(1.0, abs(shape[k])) if k in (0, 1, 5) else 1e-8
        up, down = (model(shape + sign * step, light, u[used], v[used])[0] for sign in (1.0, -1.0))
        J.append((up - down) / (2.0 * step[k]))
    numeric = np.array([np.sum(j**2) for j in J])
    assert edge.any()
    np.testing.assert_allclose(np.diag(N)[:6], numeric, rtol=0.12)


@pytest.mark.parametrize("first", [0, 6])
def test_equations_are_solved_as_numpy_solves_them(first: int) -> None:
    rng = np.random.default_rng(first)
    J, r = rng.normal(size=(40, 12)) * np.logspace(-3, 2, 12), rng.normal(size=40)
    N = np.zeros((14, 16))
    N[:12, :12], N[12, :12] = np.tril(J.T @ J), J.T @ r
    solution, covariance = np.zeros(12), np.zeros((2, 2))
    explained, solved = solve_equations(N, first, solution, covariance)
    assert solved
    expected = np.linalg.lstsq(J[:, first:], r, rcond=None)[0]
    np.testing.assert_allclose(solution[first:], expected, rtol=1e-6)
    assert not solution[:first].any()
    assert explained == pytest.approx(r @ J[:, first:] @ expected)
    if first == 0:
        np.testing.assert_allclose(covariance, np.linalg.inv(J.T @ J)[:2, :2], rtol=1e-6)
    N = np.zeros((14, 16))
    N[:12, :12] = np.tril(-J.T @ J)
    assert not solve_equations(N, first, solution, covariance)[1]


def test_the_normal_distribution_is_scipys() -> None:
    for z in np.linspace(-8.0, 8.0, 1001):
        upper, density = normal(float(z))
        assert upper == pytest.approx(0.5 * math.erfc(-z / math.sqrt(2.0)), abs=1e-8)
        assert density == pytest.approx(math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi), abs=1e-8)


def test_dots_fitted_together_are_those_fitted_alone() -> None:
    """And where the steps end, the gradient does: another step, from there, moves no centre."""
    scene = replace(scene_of(SYMMETRIC, 30.0, seed=1), noise_levels=4.0)
    image = render(scene)
    starts = np.array([[u + 0.8, v - 0.6, 0.007, 0.0, 0.008, 1.5] for u, v in scene.points_px[:20]])
    n = len(starts)
    shapes, contrast, covariance = np.zeros((n, 6)), np.zeros(n), np.zeros((n, 2, 2))
    variance, converged = np.zeros(n), np.zeros(n, dtype=np.bool_)
    options = (0.25, 12, 0.2, 0.7, 0.7)
    fit_each(image, starts, *options, shapes, contrast, covariance, variance, converged)
    assert converged.all()
    for k, start in enumerate(starts):
        shape, light, of_centre, noise, _ = fit_dot(image, start, *options)
        np.testing.assert_array_equal(shapes[k], shape)
        np.testing.assert_array_equal(covariance[k], of_centre)
        assert (contrast[k], variance[k]) == (light[3], noise)
        again = fit_dot(image, shape, 0.25, 12, 1e-3, 0.7, 0.7)[0]
        uncertainty = math.sqrt(float(np.trace(of_centre)) / 2.0 * noise)
        assert np.hypot(*(again[:2] - shape[:2])) < 0.5 * uncertainty


@pytest.mark.parametrize("share", [0.1, 0.45, 0.62, 0.9])
def test_patches_are_those_of_opencv(share: float) -> None:
    """Area, box and centre of what hangs together; moments by the pixels themselves."""
    mask = (np.random.default_rng(round(100 * share)).random((37, 53)) < share).astype(np.uint8)
    _, labels, statistics, centres = cv2.connectedComponentsWithStats(mask, connectivity=4, ltype=cv2.CV_32S)
    area, boxes, middles, second = patches(mask)
    expected = [n for n in dict.fromkeys(labels.ravel().tolist()) if n != 0]  # in the order they are met
    np.testing.assert_array_equal(area, statistics[expected, cv2.CC_STAT_AREA])
    np.testing.assert_array_equal(boxes, statistics[expected, :4])
    np.testing.assert_allclose(middles, centres[expected], atol=1e-12)
    for n, sums in zip(expected, second, strict=True):
        v, u = np.nonzero(labels == n)
        off = np.stack([u, v]) - centres[n][:, None]
        np.testing.assert_allclose(sums, off @ off.T + np.eye(2) * len(u) / 12.0, atol=1e-9)


def test_moments_of_a_rectangle() -> None:
    mask = np.zeros((12, 14), np.uint8)
    mask[2:7, 3:11] = 1
    area, boxes, middles, second = patches(mask)
    assert (area.tolist(), boxes.tolist(), middles.tolist()) == ([40.0], [[3, 2, 8, 5]], [[6.5, 4.0]])
    # of a rectangle w x h: w² / 12 and h² / 12 for each of its w h pixels
    np.testing.assert_allclose(second[0], np.diag([64.0 / 12.0, 25.0 / 12.0]) * 40.0, atol=1e-9)
