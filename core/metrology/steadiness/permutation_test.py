"""Nine statistics of order in the cycles, and one test of them all by permutation.

Columns are whitened series of three components: the common one, then the poses'. Over cycles t = 1..n, for each column

    trend             |Σ τ_t z_t|² / Σ τ_t²,                 τ_t the cycle less the mean cycle,
    change point      max_k |Σ_{t≤k} z_t|² / (k (n - k) / n),
    autocorrelation   Σ_t z_t · z_{t+1} / √pairs,

each for the common series, summed over the poses (the change point at one k for all of them), and for the worst pose.
Where cycles are independent and identically distributed, every order of them is equally likely, whatever that
distribution and whatever a cycle's poses have in common: permuting the cycles jointly for all poses gives each
statistic's own distribution. The omnibus is the most extreme of the nine, each as a normal score (cube roots of the
sums of squares, after Wilson and Hilferty, less the mean, over the standard deviation of all permutations), and its p
is its rank among the permutations' own: exact for complete cycles. Where poses lack cycles the gaps move with the
cycles, and the statistics are scaled to the cycles that remain.

References: E. J. G. Pitman, J. R. Stat. Soc. Suppl. 4 (1937) 119-130, doi:10.2307/2984124; P. H. Westfall, S. S. Young,
"Resampling-Based Multiple Testing", 1993, §2.3 (least p, single step); E. B. Wilson, M. M. Hilferty, PNAS 17 (1931)
684-688, doi:10.1073/pnas.17.12.684.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from core.jit import jit
from core.metrology.steadiness.cycle_grid import CycleGrid

MAX_PERMUTATIONS = 1999
MIN_PERMUTATIONS = 399
KINDS = ("trend", "change_point", "autocorrelation")
_CELLS = 1_200_000
"""Permutations times cycles times poses that may be computed: larger sessions get fewer permutations."""
_CHUNK = 20_000
_SEED = 20260
_TIES = 1e-9
_LEAST_SIDE = 2


@dataclass(frozen=True, slots=True)
class PermutationTest:
    """p of the omnibus, of each kind of statistic, and of each pose (single step: adjusted for all poses)."""

    overall: float
    kinds: dict[str, float]
    poses: Float[np.ndarray, " p"]
    permutations: int


def permutation_test(grid: CycleGrid) -> PermutationTest:
    """Test whether the order of the cycles matters; the same cycles give the same result."""
    z = np.concatenate([grid.common_whitened[:, None], grid.whitened], axis=1)
    seen = (grid.common_covariance != 0.0).any(axis=(1, 2))
    present = np.column_stack([seen, grid.present])
    n, columns = present.shape
    draws = int(np.clip(_CELLS // (n * columns), MIN_PERMUTATIONS, MAX_PERMUTATIONS))
    chunks = np.array_split(_orders(n, draws), max(1, (draws + 1) * columns // _CHUNK))
    parts = [_statistics(z, present, chunk) for chunk in chunks]
    session, poses = (np.concatenate(found) for found in zip(*parts, strict=True))
    scores = _scores(session)
    by_kind = scores.max(axis=2)
    pose_scores = _scores(poses).max(axis=1)
    rest = pose_scores.max(axis=1)
    return PermutationTest(
        _rank(by_kind.max(axis=1)),
        {kind: _rank(by_kind[:, k]) for k, kind in enumerate(KINDS)},
        np.array([_share(rest, score) for score in pose_scores[0]]),
        draws,
    )


@lru_cache(maxsize=4)  # a session is tested as a whole and without single poses
def _orders(n: int, draws: int) -> Int[np.ndarray, "b n"]:
    """Return the order of n cycles as it is, then so many permutations."""
    orders = np.tile(np.arange(n), (draws + 1, 1))
    orders[1:] = np.random.default_rng([_SEED, n]).permuted(orders[1:], axis=1)
    return orders


def _statistics(
    z: Float[np.ndarray, "n c 3"], present: Bool[np.ndarray, "n c"], orders: Int[np.ndarray, "b n"]
) -> tuple[Float[np.ndarray, "b 3 3"], Float[np.ndarray, "b 3 p"]]:
    """Return for each order the nine statistics (kind; common, summed, worst), and those of each pose."""
    n, columns = present.shape
    there = present.astype(float)
    tau = np.arange(n) - (n - 1) / 2.0
    at_cycle = np.empty(orders.shape)
    np.put_along_axis(at_cycle, orders, np.broadcast_to(tau, orders.shape), axis=1)
    along = (at_cycle @ z.reshape(n, -1)).reshape(len(orders), columns, 3)
    total = there.sum(axis=0)
    spread = (at_cycle**2) @ there - (at_cycle @ there) ** 2 / np.maximum(total, 1.0)
    trend = np.einsum("bci,bci->bc", along, along) / np.maximum(spread, 1.0)

    highest, lag, summed = running_statistics(np.ascontiguousarray(z), there, np.ascontiguousarray(orders))
    poses = np.stack([trend[:, 1:], highest[:, 1:], lag[:, 1:]], axis=1)
    common = np.stack([trend[:, 0], highest[:, 0], lag[:, 0]], axis=1)
    all_poses = np.stack([trend[:, 1:].sum(axis=1), summed, lag[:, 1:].sum(axis=1)], axis=1)
    return np.stack([common, all_poses, poses.max(axis=2)], axis=2), poses


@jit("f8[:, :, ::1], f8[:, ::1], i8[:, ::1]")
def running_statistics(
    z: Float[np.ndarray, "n c 3"], there: Float[np.ndarray, "n c"], orders: Int[np.ndarray, "b n"]
) -> tuple[Float[np.ndarray, "b c"], Float[np.ndarray, "b c"], Float[np.ndarray, " b"]]:
    """Return for each order the largest step of each column, its lag, and the largest step summed over the poses.

    `there` is 1 where a column has the cycle. The first column is the common series, which no sum counts.
    """
    n, columns, _ = z.shape
    highest, lag = np.zeros((len(orders), columns)), np.zeros((len(orders), columns))
    summed = np.zeros(len(orders))
    total = there.sum(axis=0)
    for b in range(len(orders)):
        sums, count, pairs = np.zeros((columns, 3)), np.zeros(columns), np.zeros(columns)
        for t in range(n):
            row, before = orders[b, t], orders[b, max(t - 1, 0)]
            of_poses = 0.0
            for c in range(columns):
                square, product = 0.0, 0.0
                for i in range(3):
                    value = z[row, c, i]
                    sums[c, i] += value
                    square += sums[c, i] * sums[c, i]
                    product += value * z[before, c, i]
                if t > 0:
                    lag[b, c] += product
                    pairs[c] += there[row, c] * there[before, c]
                count[c] += there[row, c]
                left = total[c] - count[c]
                if count[c] >= _LEAST_SIDE and left >= _LEAST_SIDE:
                    step = square * (total[c] / (count[c] * left))
                    highest[b, c] = max(highest[b, c], step)
                    if c > 0:
                        of_poses += step
            summed[b] = max(summed[b], of_poses)
        for c in range(columns):
            lag[b, c] /= np.sqrt(max(pairs[c], 1.0))
    return highest, lag, summed


def _scores(statistics: Float[np.ndarray, "b 3 k"]) -> Float[np.ndarray, "b 3 k"]:
    """Return normal scores; a statistic that is the same for every order has none."""
    values = statistics.copy()
    values[:, :2] = np.cbrt(values[:, :2])
    spread = values.std(axis=0)
    varies = spread > _TIES * (1.0 + np.abs(values).max(axis=0))
    return np.asarray(
        np.where(varies, (values - values.mean(axis=0)) / np.where(varies, spread, 1.0), -np.inf)
    )


def _rank(scores: Float[np.ndarray, " b"]) -> float:
    return _share(scores, float(scores[0]))


def _share(scores: Float[np.ndarray, " b"], observed: float) -> float:
    """Return the share of orders, the observed one included, that are as extreme; ties by rounding count."""
    if observed == -np.inf:
        return 1.0
    return float(np.mean(scores >= observed - _TIES * (1.0 + abs(observed))))
