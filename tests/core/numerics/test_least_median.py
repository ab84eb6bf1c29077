"""The set of points that most others agree with."""

from __future__ import annotations

import numpy as np

from core.numerics.least_median import best_subset

X = np.linspace(0.0, 1.0, 12)


def lines_through(y: np.ndarray, sets: np.ndarray) -> np.ndarray:
    """Lengths of all points' residuals about the line of each set."""
    found = [np.polyfit(X[chosen], y[chosen], 1) for chosen in sets]
    return np.abs(np.array([np.polyval(line, X) - y for line in found]))[:, None]


def test_a_set_without_the_wrong_points_is_found() -> None:
    y = 2.0 * X + 1e-3 * np.random.default_rng(0).normal(size=12)
    y[[1, 4, 9]] += [30.0, -50.0, 80.0]
    of_all = lines_through(y, np.arange(12)[None])[0]
    chosen = best_subset(lambda sets: lines_through(y, sets), of_all, size=3, number=60)
    assert chosen is not None
    assert len(chosen) == 3
    assert not set(chosen.tolist()) & {1, 4, 9}
    again = best_subset(lambda sets: lines_through(y, sets), of_all, size=3, number=60)
    np.testing.assert_array_equal(chosen, again)


def test_what_all_points_say_stands_where_no_set_is_better() -> None:
    of_all = np.full((2, 12), 0.1)
    same = lambda sets: np.full((len(sets), 2, 12), 0.1)  # noqa: E731
    assert best_subset(same, of_all, size=3, number=10) is None
    without = lambda sets: np.full((len(sets), 2, 12), np.inf)  # noqa: E731
    assert best_subset(without, of_all, size=3, number=10) is None


def test_every_kind_of_residual_counts() -> None:
    """A set that halves one kind and triples the other is no better."""
    of_all = np.ones((2, 12))

    def traded(sets: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.array([0.5, 3.0])[None, :, None], (len(sets), 2, 12))

    assert best_subset(traded, of_all, size=3, number=5) is None
