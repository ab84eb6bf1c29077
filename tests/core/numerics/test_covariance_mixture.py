"""Sizes of the components of a covariance from samples of it."""

from __future__ import annotations

import numpy as np
import pytest

from core.numerics import SampleCovariance, estimate_components, first_component_alone, log_likelihood


def samples(
    sizes: list[float], *, seed: int = 3, groups: int = 4, freedom: int = 400
) -> list[SampleCovariance]:
    """Draw sample covariances of ten quantities: white noise, noise common to neighbours, noise common to all."""
    rng = np.random.default_rng(seed)
    place = np.arange(10.0)
    components = np.stack(
        [np.eye(10), np.exp(-0.5 * (place[:, None] - place) ** 2), np.ones((10, 10))],
    )
    root = np.linalg.cholesky(np.tensordot(sizes, components, axes=1))
    drawn = [rng.standard_normal((freedom, 10)) @ root.T for _ in range(groups)]
    return [SampleCovariance(one.T @ one / freedom, float(freedom), components) for one in drawn]


@pytest.mark.parametrize("sizes", [[1.0, 2.0, 0.5], [4e-6, 1e-6, 3e-6], [1.0, 0.0, 3.0]])
def test_the_sizes_are_found(sizes: list[float]) -> None:
    """Within five standard errors: of 1,600 samples a variance is known to 3.5 %, components share that."""
    found = estimate_components(samples(sizes))
    assert np.all(found >= 0.0)
    assert found == pytest.approx(sizes, rel=0.3, abs=0.05 * sum(sizes))


def test_of_white_noise_nothing_else_is_left() -> None:
    found = estimate_components(samples([2.0, 0.0, 0.0]))
    assert found[0] == pytest.approx(2.0, rel=0.1)
    assert np.all(found[1:] < 0.1)


def test_the_likelihood_is_that_of_a_maximum() -> None:
    """Neighbouring sizes are less likely, and white noise alone far less."""
    groups = samples([1.0, 2.0, 0.5])
    found = estimate_components(groups)
    best = log_likelihood(groups, found)
    for k in range(3):
        for factor in (0.9, 1.1):
            changed = found.copy()
            changed[k] *= factor
            assert log_likelihood(groups, changed) < best
    white = first_component_alone(groups)
    assert np.count_nonzero(white) == 1
    assert log_likelihood(groups, white) < best - 100.0


def test_many_components_come_to_the_maximum() -> None:
    """Thirty components that nearly repeat each other, of which three are there: to one in log L of what 2,000 safe
    steps find.
    """
    rng = np.random.default_rng(5)
    place = np.arange(20.0)
    off = np.abs(place[:, None] - place)
    smooth = [np.exp(-0.5 * (off / length) ** 2) for length in np.linspace(0.5, 8.0, 29)]
    components = np.stack([np.eye(20), *smooth])
    root = np.linalg.cholesky(components[0] + 0.5 * components[4] + 2.0 * components[20])
    drawn = [rng.standard_normal((60, 20)) @ root.T for _ in range(3)]
    groups = [SampleCovariance(one.T @ one / 60.0, 60.0, components) for one in drawn]
    safe = np.full(len(components), 0.1)
    for _ in range(2000):
        found, expected = np.zeros(len(safe)), np.zeros(len(safe))
        for group in groups:
            inverse = np.linalg.inv(group.covariance(safe))
            found += np.einsum("ij,kji->k", inverse @ group.sample @ inverse, components)
            expected += np.einsum("ij,kji->k", inverse, components)
        safe *= np.sqrt(found / expected)
    assert log_likelihood(groups, estimate_components(groups)) > log_likelihood(groups, safe) - 1.0


def test_groups_count_by_their_degrees_of_freedom() -> None:
    few, many = samples([1.0, 0.0, 0.0], freedom=20, groups=1), samples([9.0, 0.0, 0.0], seed=4, groups=1)
    assert first_component_alone(few + many)[0] == pytest.approx((20 * 1.0 + 400 * 9.0) / 420, rel=0.1)


def test_nothing_to_estimate_from_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one group"):
        estimate_components([])
    still = SampleCovariance(np.zeros((2, 2)), 3.0, np.eye(2)[None])
    with pytest.raises(ValueError, match="scatter"):
        estimate_components([still])
