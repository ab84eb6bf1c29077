"""Limits of chance hold for 95 % of what does not move: of blocks' means, of trends, and of lengths."""

from __future__ import annotations

import numpy as np
import pytest

from app.analyses.documents.plots.chance import block_limits, length_limit, trend_limits

TRIALS = 1200
SCATTER = np.array([0.02, 0.05, 0.01])


@pytest.fixture(scope="module")
def still() -> np.ndarray:
    """Cycles of poses that do not move, with another scatter along each axis."""
    return np.random.default_rng(7).standard_normal((TRIALS, 30, 3)) * SCATTER


def within(share: float, count: int) -> bool:
    """Whether a share of 95 % is met, to four standard deviations of its sample."""
    return abs(share - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / count)


def test_means_of_blocks_stay_within_their_limits(still: np.ndarray) -> None:
    blocks = [(0, 10), (10, 20), (20, 30)]
    means = still.reshape(TRIALS, 3, 10, 3).mean(axis=2)
    shifts = means[:, 2] - means[:, 0]
    limits = np.array([block_limits(values, blocks) for values in still])
    assert not limits[:, 0].any()
    assert within(float(np.mean(np.abs(shifts) <= limits[:, 2])), 3 * TRIALS)
    lengths = [length_limit(one[2]) for one in limits]
    assert within(float(np.mean(np.linalg.norm(shifts, axis=1) <= lengths)), TRIALS)


def test_trends_stay_within_their_limits_and_a_drift_does_not(still: np.ndarray) -> None:
    at = np.arange(30.0)
    about = at - at.mean()
    changes = np.einsum("n,tnk->tk", about, still) / (about @ about) * 29.0
    limits = np.array([trend_limits(values, at) for values in still])
    assert within(float(np.mean(np.abs(changes) <= limits)), 3 * TRIALS)
    moved = still[0] + np.outer(at, [0.01, 0.0, 0.0])
    change = about @ moved[:, 0] / (about @ about) * 29.0
    assert change > trend_limits(moved, at)[0]


def test_what_does_not_scatter_has_no_limits() -> None:
    assert length_limit(np.zeros(3)) == 0.0
    assert not trend_limits(np.zeros((1, 3)), np.zeros(1)).any()
    assert not block_limits(np.zeros((20, 3)), [(0, 10), (10, 20)]).any()
