"""The likelihood of the linearised problem, its gradient and its solution, against plain formulas."""

from __future__ import annotations

import numpy as np
import pytest

from core.kinematics.error_model.evidence import (
    LevelProblem,
    Prior,
    Sums,
    _evaluated,
    coefficients,
    maximise,
    solve,
)
from core.kinematics.error_model.fit import Level
from core.kinematics.error_model.priors import Hyperparameters, spreads
from core.kinematics.error_model.terms import Kind, terms_of

TERMS = terms_of(1, approach=True)
FLAT, KNOWN = 3, 2
PRIOR = Prior(
    np.array([np.inf] * FLAT + [0.3, 2.0]),
    np.array([0.0] * FLAT + [0.2, -0.4]),
)


def rows(seed: int, count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    X = rng.normal(0.0, 1.0, (count, FLAT + KNOWN + len(TERMS)))
    X[:, FLAT + KNOWN :] *= 300.0  # a radian moves the end by a reach
    return X, X[:, :FLAT].sum(axis=1) + rng.normal(0.0, 1.0, count)


def sums(X: np.ndarray, y: np.ndarray, cut: int = 120) -> Sums:
    parts = [(X[:cut], y[:cut]), (X[cut:], y[cut:])]
    return Sums(
        np.array([A.T @ A for A, _ in parts]),
        np.array([A.T @ b for A, b in parts]),
        np.array([b @ b for _, b in parts]),
        np.array([float(len(b)) for _, b in parts]),
    )


def plain(X: np.ndarray, y: np.ndarray, v: np.ndarray, noise: np.ndarray) -> float:
    """The restricted likelihood by the covariance of y itself."""
    V = np.diag(noise) + (X[:, FLAT:] * v) @ X[:, FLAT:].T
    off = y - X[:, FLAT : FLAT + KNOWN] @ PRIOR.means[FLAT:]
    F = X[:, :FLAT]
    W = np.linalg.inv(V)
    A = F.T @ W @ F
    P = W - W @ F @ np.linalg.solve(A, F.T @ W)
    return float(np.linalg.slogdet(V)[1] + np.linalg.slogdet(A)[1] + off @ P @ off)


def test_the_likelihood_is_that_of_the_covariance_of_the_rows() -> None:
    X, y = rows(1)
    noise = np.array([0.7, 1.6])
    by_row = np.repeat(noise, [120, 180])
    values = []
    for factor in (1.0, 5.0):
        v = factor * Hyperparameters.defaults().variances(TERMS)[0]
        state = _evaluated(sums(X, y), PRIOR, v, noise)
        values.append(state.value - plain(X, y, np.concatenate([PRIOR.variances[FLAT:], v]), by_row))
    assert values[0] == pytest.approx(0.0, abs=1e-6)
    assert values[1] == pytest.approx(0.0, abs=1e-6)


def test_the_gradient_is_that_of_the_value() -> None:
    X, y = rows(2)
    given = sums(X, y)
    v = Hyperparameters.defaults().variances(TERMS)[0]
    noise = np.array([0.7, 1.6])
    state = _evaluated(given, PRIOR, v, noise)
    step = 1e-4

    def value(by_v: np.ndarray, by_noise: np.ndarray) -> float:
        return _evaluated(given, PRIOR, v * np.exp(by_v), noise * np.exp(by_noise)).value

    for kind in Kind:
        moved = step * TERMS.of(kind)
        difference = (value(moved, np.zeros(2)) - value(-moved, np.zeros(2))) / (2.0 * step)
        stated = state.by_log_variance[FLAT + KNOWN :][TERMS.of(kind)].sum()
        assert difference == pytest.approx(stated, rel=1e-4, abs=1e-5)
    for k in range(2):
        moved = step * np.eye(2)[k]
        difference = (value(np.zeros(len(v)), moved) - value(np.zeros(len(v)), -moved)) / (2.0 * step)
        assert difference == pytest.approx(state.by_log_noise[k], rel=1e-4, abs=1e-5)


def test_hyperparameters_have_the_derivatives_they_state() -> None:
    at = Hyperparameters.defaults()
    v, by = at.variances(TERMS)
    step = 1e-5
    for h in range(7):
        moved = Hyperparameters(at.log_values + step * np.eye(7)[h])
        numeric = (np.log(moved.variances(TERMS)[0]) - np.log(v)) / step
        assert by[h] == pytest.approx(numeric, abs=1e-4)


def test_the_coefficients_are_those_of_the_augmented_rows() -> None:
    X, y = rows(3)
    noise = np.array([0.7, 1.6])
    at = Hyperparameters.defaults()
    chosen = Level.COMPLIANCE.chosen(TERMS)
    problem = LevelProblem(sums(X, y), PRIOR, TERMS, chosen)
    found = solve(problem, at, noise)
    columns = np.concatenate([np.ones(FLAT + KNOWN, dtype=bool), chosen])
    v = np.concatenate([PRIOR.variances, at.variances(TERMS)[0]])[columns]
    w = 1.0 / np.repeat(noise, [120, 180])
    taken = X[:, columns]
    A = taken.T @ (taken * w[:, None]) + np.diag(1.0 / v)
    mean = np.zeros(len(v))
    mean[FLAT : FLAT + KNOWN] = PRIOR.means[FLAT:] / PRIOR.variances[FLAT:]
    assert found.coefficients[columns] == pytest.approx(
        np.linalg.solve(A, taken.T @ (w * y) + mean), abs=1e-9
    )
    assert found.covariance[np.ix_(columns, columns)] == pytest.approx(np.linalg.inv(A), rel=1e-6, abs=1e-9)
    assert not found.coefficients[~columns].any()
    alone = coefficients(problem, at, noise)
    assert alone == pytest.approx(found.coefficients, abs=1e-12)


def test_hyperparameters_of_rows_without_terms_become_small_and_the_noise_is_found() -> None:
    X, y = rows(4, 3000)
    begin = (Hyperparameters.defaults(), np.ones(2))
    problem = LevelProblem(sums(X, y, 1500), PRIOR, TERMS, Level.ALL.chosen(TERMS))
    found = maximise(problem, begin, spreads(500), np.full(2, 1e-6))
    assert found.noise == pytest.approx(
        [1.0, 1.0], abs=0.15
    )  # 1,500 rows each: 3.7 % is one standard deviation
    assert found.minus_2_log <= _evaluated(problem.sums, PRIOR, begin[0].variances(TERMS)[0], begin[1]).value
    few = maximise(problem, begin, np.zeros(7), np.full(2, 1e-6))
    assert np.array_equal(few.hyperparameters.log_values, begin[0].log_values)
