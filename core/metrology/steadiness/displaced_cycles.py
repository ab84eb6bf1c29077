"""Cycles in which all poses were displaced together, as where a mount, a target or an instrument was bumped.

One cycle changes no statistic of the order of cycles much. With d_ic the deviation of pose i in cycle c from the pose's
median, the common displacement is m_c, the median of d_ic over the poses, which a single pose far off does not shift.
The r ≤ 2 cycles of the largest m are displaced where, with mean and covariance of m over the other k = n - r cycles,

    t_c² = (m_c - m̄)ᵀ S⁻¹ (m_c - m̄),     t_c² k / (k + 1) ~ 3 (k - 1) / (k - 3) F_{3, k-3}

is beyond a chance of `MAX_CHANCE` in the whole session, shared by all choices of one and two cycles, and t_c is
`MIN_GAP` times the largest t of the others. The gap leaves alone what wanders, where an extreme cycle has neighbours
that are nearly as extreme, and tails of the common motion. In each of them five of six poses, and all of fewer, have to
have moved along m_c by half of it or more.

Reference: T. W. Anderson, An Introduction to Multivariate Statistical Analysis, 3rd ed. 2003, §5.2 (T² of a new one).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

from core.metrology.steadiness.cycle_grid import CycleGrid

MAX_CHANCE = 1e-3
MIN_CYCLES = 10
"""The scatter of fewer is too uncertain to judge by."""
MIN_POSES = 3
"""Of two, chance and heavy tails displace both together now and then."""
MIN_GAP = 2.5
MAX_DISPLACED = 2
_MIN_ALONG = 0.5
"""A pose moved along with the others by this share of the common displacement."""
_EXCEPTIONS = 6
"""One of so many poses need not; of fewer, none."""
_RIDGE = 1e-9


@dataclass(frozen=True, slots=True)
class DisplacedCycle:
    """A cycle by its number, the displacement common to its poses, mm, and the usual one of the other cycles."""

    cycle: int
    displacement_mm: Float[np.ndarray, "3"]
    usual_mm: float


def find_displaced_cycles(grid: CycleGrid) -> tuple[DisplacedCycle, ...]:
    """Return the cycles in which the poses moved together, in their order; none where visits share no cycles."""
    poses = np.flatnonzero((grid.weights != 0.0).any(axis=(1, 2)))
    present = grid.present[:, poses]
    rows = np.flatnonzero(present.sum(axis=1) >= max(MIN_POSES, (len(poses) + 1) // 2))
    if grid.by_visit or len(poses) < MIN_POSES or len(rows) < MIN_CYCLES:
        return ()
    seen = present[rows][..., None]
    moved = np.where(seen, grid.deviations_mm[np.ix_(rows, poses)], np.nan)
    kept = (~np.isnan(moved[..., 0])).sum(axis=0) > 1
    moved = moved[:, kept] - np.nanmedian(moved[:, kept], axis=0)
    count = (~np.isnan(moved[..., 0])).sum(axis=1)
    if (count < MIN_POSES).any():
        return ()
    common = np.nanmedian(moved, axis=1)
    common = common - np.median(common, axis=0)
    scaled = common * np.sqrt(count / count.max())[:, None]
    order = np.argsort(-_robust_sizes(scaled), kind="stable")
    for number in range(MAX_DISPLACED, 0, -1):
        first, rest = order[:number], order[number:]
        if not _far(scaled[first], scaled[rest]) or not all(_together(moved[c], common[c]) for c in first):
            continue
        usual = float(np.sqrt(np.mean(np.sum(common[rest] ** 2, axis=1))))
        return tuple(
            DisplacedCycle(int(grid.numbers[rows[c]]), common[c], usual) for c in sorted(first.tolist())
        )
    return ()


def _robust_sizes(common: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the sizes of displacements in units of their median ones along their principal axes."""
    along = common @ np.linalg.eigh(common.T @ common)[1]
    usual = np.median(np.abs(along), axis=0)
    return np.asarray(np.linalg.norm(along / np.where(usual > 0.0, usual, 1.0), axis=1))


def _far(first: Float[np.ndarray, "r 3"], rest: Float[np.ndarray, "k 3"]) -> bool:
    """Return whether each of the first displacements is far beyond what the rest explains."""
    k = len(rest)
    about = rest - rest.mean(axis=0)
    covariance = about.T @ about / (k - 1)
    trace = float(np.trace(covariance))
    if trace == 0.0:
        return False
    inverse = np.linalg.inv(covariance + _RIDGE * trace * np.eye(3))
    off = first - rest.mean(axis=0)
    least = float(np.einsum("ri,ij,rj->r", off, inverse, off).min())
    largest = float(np.einsum("ri,ij,rj->r", about, inverse, about).max())
    chance = float(fdtrc(3.0, k - 3.0, least * k / (k + 1.0) * (k - 3.0) / (3.0 * (k - 1.0))))
    n = k + len(first)
    return chance < MAX_CHANCE / (0.5 * n * (n + 1)) and least > MIN_GAP**2 * largest


def _together(moved: Float[np.ndarray, "p 3"], common: Float[np.ndarray, "3"]) -> bool:
    """Return whether nearly all poses moved along the common displacement; those not visited are nan."""
    along = moved[~np.isnan(moved[:, 0])] @ common / float(common @ common)
    return int(np.sum(along < _MIN_ALONG)) <= len(along) // _EXCEPTIONS
