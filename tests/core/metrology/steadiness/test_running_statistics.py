"""The kernel of the permutation test against its twin in numpy, for complete cycles and for some that are missing."""

from __future__ import annotations

import numpy as np
import pytest

from core.metrology.steadiness.permutation_test import running_statistics


def twin(z: np.ndarray, there: np.ndarray, orders: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what the kernel does, by arrays of orders by cycles by columns."""
    values, seen = z[orders], there[orders]
    total, count = there.sum(axis=0), seen.cumsum(axis=1)
    inside = (count >= 2) & (total - count >= 2)
    weight = np.where(inside, total / np.where(inside, count * (total - count), 1.0), 0.0)
    steps = (values.cumsum(axis=1) ** 2).sum(axis=3) * weight
    pairs = (seen[:, 1:] * seen[:, :-1]).sum(axis=1)
    lag = (values[:, 1:] * values[:, :-1]).sum(axis=(1, 3)) / np.sqrt(np.maximum(pairs, 1.0))
    return steps.max(axis=1), lag, steps[:, :, 1:].sum(axis=2).max(axis=1)


@pytest.mark.parametrize("missing", [0.0, 0.2, 0.8])
def test_statistics_are_those_of_the_twin(missing: float) -> None:
    rng = np.random.default_rng(2)
    there = (rng.uniform(size=(12, 5)) >= missing).astype(float)
    z = rng.normal(size=(12, 5, 3)) * there[:, :, None]
    orders = rng.permuted(np.tile(np.arange(12), (40, 1)), axis=1)
    for found, expected in zip(running_statistics(z, there, orders), twin(z, there, orders), strict=True):
        assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)
