"""The solver: known minima, gross errors, priors, and covariances against what noise really does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.numerics.least_squares import Evaluate, fit
from core.numerics.normal_equations import damped_step

X = np.linspace(-1.0, 1.0, 80)


def line(observed: np.ndarray) -> Evaluate[np.ndarray]:
    """y = a + b x with one residual a point."""

    def evaluate(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (observed - state[0] - state[1] * X)[None], np.stack([np.ones_like(X), X])[:, None]

    return evaluate


def add(state: np.ndarray, step: np.ndarray) -> np.ndarray:
    return state + step


def test_a_straight_line_is_the_textbook_one() -> None:
    rng = np.random.default_rng(1)
    y = 2.0 + 3.0 * X + rng.normal(0.0, 0.1, len(X))
    result = fit(line(y), add, np.zeros(2), np.ones(len(X)))
    A = np.stack([np.ones_like(X), X], axis=1)
    expected, square_sum = np.linalg.lstsq(A, y, rcond=None)[:2]
    assert result.converged
    assert result.used.all()
    np.testing.assert_allclose(result.state, expected, atol=1e-10)
    variance = square_sum[0] / (len(X) - 2)
    assert result.degrees_of_freedom == pytest.approx(len(X) - 2)
    np.testing.assert_allclose(result.covariance, np.linalg.inv(A.T @ A) * variance, rtol=1e-6)


def test_unequal_uncertainties_are_weights() -> None:
    rng = np.random.default_rng(2)
    uncertainty = np.where(np.arange(len(X)) % 2 == 0, 0.01, 0.3)
    y = 2.0 + 3.0 * X + rng.normal(0.0, uncertainty)
    result = fit(line(y), add, np.zeros(2), uncertainty)
    A = np.stack([np.ones_like(X), X], axis=1) / uncertainty[:, None]
    np.testing.assert_allclose(result.state, np.linalg.lstsq(A, y / uncertainty, rcond=None)[0], atol=1e-9)


def test_a_fifth_of_gross_errors_is_rejected_and_leaves_no_trace() -> None:
    rng = np.random.default_rng(3)
    y = 2.0 + 3.0 * X + rng.normal(0.0, 0.05, len(X))
    wrong = rng.permutation(len(X))[: len(X) // 5]
    spoiled = y.copy()
    spoiled[wrong] += rng.choice([-1, 1], len(wrong)) * 20.0
    result = fit(line(spoiled), add, np.zeros(2), np.ones(len(X)))
    assert not result.used[wrong].any()
    A = np.stack([np.ones_like(X), X], axis=1)[result.used]
    np.testing.assert_allclose(result.state, np.linalg.lstsq(A, y[result.used], rcond=None)[0], atol=1e-8)


@pytest.mark.parametrize("start", [(1.2, 0.8), (5.0, 0.1), (0.5, 2.0)])
def test_a_curved_problem_is_solved_from_afar(start: tuple[float, float]) -> None:
    t = np.linspace(0.0, 3.0, 60)
    y = 2.5 * np.exp(-1.3 * t)

    def evaluate(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        decay = np.exp(-state[1] * t)
        return (y - state[0] * decay)[None], np.stack([decay, -state[0] * t * decay])[:, None]

    result = fit(evaluate, add, np.array(start), np.ones(len(t)))
    assert result.converged
    np.testing.assert_allclose(result.state, [2.5, 1.3], atol=1e-7)


def test_a_prior_is_a_measurement() -> None:
    rng = np.random.default_rng(4)
    sigma = 0.1
    y = 2.0 + 3.0 * X + rng.normal(0.0, sigma, len(X))

    def prior(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([(2.9 - state[1]) / 0.01]), np.array([[0.0, 100.0]])

    free = fit(line(y), add, np.zeros(2), np.ones(len(X)))
    held = fit(line(y), add, np.zeros(2), np.ones(len(X)), prior=prior)
    # Inverse-variance weighting of the free slope and the prior, at the held fit's own noise scale.
    variance = free.covariance[1, 1] * (held.scale / free.scale) ** 2
    weight = 1.0 / variance, 1.0 / 0.01**2
    expected = (weight[0] * free.state[1] + weight[1] * 2.9) / sum(weight)
    assert held.state[1] == pytest.approx(expected, abs=2e-4)
    assert held.covariance[1, 1] == pytest.approx(1.0 / sum(weight), rel=1e-3)
    assert len(X) - 2 < held.degrees_of_freedom < len(X) - 1


def test_what_the_data_do_not_determine_is_singular() -> None:
    def evaluate(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (X - state[0] - state[1])[None], np.ones((2, 1, len(X)))

    result = fit(evaluate, add, np.zeros(2), np.ones(len(X)))
    assert result.status == "singular"
    assert not result.converged


def test_noise_free_data_are_met_exactly() -> None:
    result = fit(line(2.0 + 3.0 * X), add, np.zeros(2), np.ones(len(X)))
    assert result.converged
    np.testing.assert_allclose(result.state, [2.0, 3.0], atol=1e-12)


def test_the_stated_covariance_is_what_noise_does() -> None:
    rng = np.random.default_rng(6)
    trials, hits = 600, 0
    for _ in range(trials):
        y = 2.0 + 3.0 * X + rng.normal(0.0, 0.1, len(X))
        result = fit(line(y), add, np.zeros(2), np.ones(len(X)))
        hits += abs(result.state[1] - 3.0) < 1.96 * math.sqrt(result.covariance[1, 1])
    # Binomial: 95 % of 600 has a standard deviation of .9 %; four of those either way.
    assert abs(hits / trials - 0.95) < 4 * math.sqrt(0.95 * 0.05 / trials)


@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_steps_are_those_of_the_normal_equations(damping: float) -> None:
    rng = np.random.default_rng(7)
    J = rng.normal(size=(30, 6)) * np.array([1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6])
    H, g = J.T @ J, J.T @ rng.normal(size=30)
    unit = np.sqrt(np.diag(H))
    damped = H / np.outer(unit, unit) + damping * np.eye(6)
    expected = np.linalg.solve(damped, g / unit) / unit
    step, length = damped_step(H, g, damping)
    np.testing.assert_allclose(step, expected, rtol=1e-9)
    assert length == pytest.approx(math.sqrt(expected @ H @ expected), rel=1e-9)


@pytest.mark.parametrize(
    "H", [np.zeros((2, 2)), np.ones((2, 2)), np.array([[1.0, 2.0], [2.0, 1.0]]), np.full((2, 2), np.nan)]
)
def test_there_is_no_step_without_a_positive_definite_matrix(H: np.ndarray) -> None:
    assert damped_step(H, np.ones(2), 0.0)[1] == math.inf


def test_gross_errors_that_hide_one_another_are_found() -> None:
    """A sixth of the points off together: a plain line takes half of it up, and no residual stands out. What gives
    them away is that the residuals are larger than stated.
    """
    rng = np.random.default_rng(8)
    y = 2.0 + 3.0 * X + rng.normal(0.0, 0.01, len(X))
    together = X > 0.7
    plain = np.polynomial.polynomial.polyfit(X, y + 0.3 * together, 1)
    distance = np.abs(y + 0.3 * together - plain[0] - plain[1] * X)
    assert distance.max() < 4.0 * np.median(distance)
    result = fit(line(y + 0.3 * together), add, np.zeros(2), np.full(len(X), 0.01))
    np.testing.assert_array_equal(result.used, ~together)
    np.testing.assert_allclose(result.state, [2.0, 3.0], atol=0.01)


@pytest.mark.parametrize("stated", [1e-3, 0.1, 10.0])
def test_the_level_of_the_stated_uncertainty_does_not_matter_without_gross_errors(stated: float) -> None:
    """It decides by which way the answer is found, not what it is."""
    rng = np.random.default_rng(9)
    y = 2.0 + 3.0 * X + rng.normal(0.0, 0.1, len(X))

    def prior(state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([(2.9 - state[1]) / 0.01]), np.array([[0.0, 100.0]])

    usual = fit(line(y), add, np.zeros(2), np.full(len(X), 0.1), prior=prior)
    found = fit(line(y), add, np.zeros(2), np.full(len(X), stated), prior=prior)
    sigma = np.sqrt(np.diag(usual.covariance))
    np.testing.assert_allclose((found.state - usual.state) / sigma, 0.0, atol=0.005)
    np.testing.assert_allclose(found.covariance, usual.covariance, rtol=1e-3)
