"""Variance components: known answers, the score's root, and what the estimate is worth."""

from __future__ import annotations

import numpy as np
import pytest

from core.numerics.variance_components import (
    SMALLEST,
    LinearResiduals,
    Variances,
    estimate_variances,
    weights,
)


def drawn(rng: np.random.Generator, n: int, parameters: int) -> LinearResiduals:
    """Poses with covariances of their own, a linear model, and a robot of .5 mm and .7 mrad."""
    unit = np.array([1.0] * 3 + [1e-3] * 3)
    J = rng.normal(size=(n, 6, parameters)) * unit[:, None]
    A = 0.1 * rng.normal(size=(n, 6, 6))
    known = (A @ A.swapaxes(1, 2) + 0.05 * np.eye(6)) * np.outer(unit, unit)
    robot = np.array([0.5] * 3 + [0.7e-3] * 3)
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(known), rng.normal(size=(n, 6)))
    return LinearResiduals(known, noise + robot * rng.normal(size=(n, 6)), J)


def test_about_a_mean_it_is_the_variance_of_n_minus_1() -> None:
    y = np.random.default_rng(1).normal(0.0, [3.0, 3.0, 3.0], (9, 3))
    group = LinearResiduals(np.zeros((9, 3, 3)), y, np.tile(np.eye(3), (9, 1, 1)))
    found = estimate_variances([group], Variances(1.0, 4e-6))
    assert found.position == pytest.approx(float(np.var(y, axis=0, ddof=1).mean()), rel=1e-3)
    assert found.rotation == 4e-6  # positions say nothing of it


@pytest.mark.parametrize("seed", range(5))
def test_the_score_vanishes_at_the_estimate(seed: int) -> None:
    """yᵀP E P y = tr(P E) for either kind, with P written out over all poses at once."""
    group = drawn(np.random.default_rng(seed), 30, 12)
    found = estimate_variances([group], Variances(1.0, 1e-6))
    V = np.zeros((180, 180))
    for i, known in enumerate(group.known):
        V[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = known + np.diag(found.diagonal(6))
    J, y = group.jacobian.reshape(180, 12), group.residuals.ravel()
    inverse = np.linalg.inv(V)
    P = inverse - inverse @ J @ np.linalg.solve(J.T @ inverse @ J, J.T @ inverse)
    for first in (0, 3):
        rows = np.ravel(6 * np.arange(30)[:, None] + first + np.arange(3))
        assert np.sum((P @ y)[rows] ** 2) == pytest.approx(np.trace(P[np.ix_(rows, rows)]), rel=2e-3)


def test_a_fit_at_its_own_variances_says_the_same_as_one_that_follows_them() -> None:
    group = drawn(np.random.default_rng(7), 40, 9)
    following = estimate_variances([group], Variances(1.0, 1e-6))
    W = weights(group.known, following)
    WJ = (W @ group.jacobian).reshape(-1, 9)
    covariance = np.linalg.inv(WJ.T @ WJ)
    fitted = covariance @ (WJ.T @ np.einsum("nij,nj->ni", W, group.residuals).ravel())
    left = LinearResiduals(
        group.known, group.residuals - group.jacobian @ fitted, group.jacobian, covariance=covariance
    )
    held = estimate_variances([left], following)
    assert held.near(following, 1e-3)


def test_exact_poses_end_at_the_floor() -> None:
    group = LinearResiduals(np.zeros((8, 6, 6)), np.zeros((8, 6)), np.zeros((8, 6, 1)))
    assert estimate_variances([group], Variances(1.0, 1.0)) == SMALLEST
    least = Variances.of_deviations(1e-3, 1e-6)
    assert estimate_variances([group], Variances(1.0, 1.0), least) == least


def test_no_poses_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one group"):
        estimate_variances([], SMALLEST)


def test_variances_of_several_groups_are_unbiased_and_one_at_its_floor_does_not_lift_the_other() -> None:
    rng = np.random.default_rng(8)
    found = []
    for _ in range(150):
        arcs = []
        for _ in range(4):
            J = rng.normal(0.0, 1.0, (12, 6, 10))
            own = np.tile(np.diag([0.01] * 3 + [1e-6] * 3), (12, 1, 1))
            noise = rng.normal(0.0, 1.0, (12, 6)) * np.sqrt([0.05] * 3 + [1e-6] * 3)
            V = np.array([0.05] * 3 + [1e-6] * 3)
            scaled = (J / np.sqrt(V)[:, None]).reshape(72, 10)
            fitted = scaled @ np.linalg.lstsq(scaled, (noise / np.sqrt(V)).ravel(), rcond=None)[0]
            arcs.append(LinearResiduals(own, noise - fitted.reshape(12, 6) * np.sqrt(V), J))
        variances = estimate_variances(arcs, Variances(1e-4, 1e-10))
        found.append((variances.position, variances.rotation))
    position, rotation = np.array(found).T
    # Each estimate has some 120 degrees of freedom: 13 % of .05, and 1 % for the mean of 150; three of those.
    assert np.mean(position) == pytest.approx(0.04, abs=0.002)
    # None is there: half of the estimates are at the floor, the others small against the instrument's 1e-6.
    assert 0.3 < np.mean(rotation <= 1.01e-18) < 0.75
    assert np.mean(rotation) < 1.5e-7
