"""How much moved: trend and change point of the common series and of each pose, mm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.metrology.steadiness.cycle_grid import CycleGrid

_LEAST_SIDE = 2
_LOW_MODES = 5
"""Slow motion is what the lower fifth of the cosine modes hold."""


@dataclass(frozen=True, slots=True)
class Trend:
    """Change over the session along x, y, z by a straight line, mm, and its standard uncertainty."""

    change_mm: Float[np.ndarray, "3"]
    standard_uncertainty_mm: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class ChangePoint:
    """Step at one place, mm: mean of the cycles from `cycle` on less that of the cycles before, and its uncertainty."""

    cycle: int
    step_mm: Float[np.ndarray, "3"]
    standard_uncertainty_mm: Float[np.ndarray, "3"]


def common_trend(grid: CycleGrid) -> Trend:
    """Return the trend of the common series, weighted by what each cycle knows of it."""
    row, variance = _line(len(grid.numbers), np.asarray(grid.present.any(axis=1)))
    return Trend(row @ grid.common_mm, _uncertainty(variance, _common_covariance(grid)))


def pose_trends(grid: CycleGrid) -> Float[np.ndarray, "p 3"]:
    """Return each pose's change over the session, mm."""
    rows = [_line(len(grid.numbers), seen)[0] for seen in grid.present.T]
    return np.einsum("pn,npi->pi", np.array(rows), grid.deviations_mm)


def change_place(grid: CycleGrid, pose: int | None) -> int | None:
    """Return the row of the first cycle after the step: of all poses, or of one; None where no place qualifies."""
    chosen = slice(None) if pose is None else slice(pose, pose + 1)
    present = grid.present[:, chosen].astype(float)
    count = np.cumsum(present, axis=0)
    total = count[-1]
    valid = (count >= _LEAST_SIDE) & (total - count >= _LEAST_SIDE)
    if not valid.any():
        return None
    weight = np.where(valid, total / np.where(valid, count * (total - count), 1.0), 0.0)
    sums = np.cumsum(grid.whitened[:, chosen], axis=0)
    gain = (np.einsum("npi,npi->np", sums, sums) * weight).sum(axis=1)
    return int(np.argmax(gain)) + 1


def common_step(grid: CycleGrid, place: int) -> ChangePoint:
    """Return the step of the common series at this row."""
    n = len(grid.numbers)
    variance = 1.0 / place + 1.0 / (n - place)
    step = grid.common_mm[place:].mean(axis=0) - grid.common_mm[:place].mean(axis=0)
    return ChangePoint(
        int(grid.numbers[place]), step, _uncertainty(variance, _common_covariance(grid, place))
    )


def pose_steps(grid: CycleGrid, place: int) -> Float[np.ndarray, "p 3"]:
    """Return each pose's step at this row, mm; zero for a pose that was not visited on both sides."""
    before, after = grid.present[:place].sum(axis=0), grid.present[place:].sum(axis=0)
    both = (before > 0) & (after > 0)
    step = (
        grid.deviations_mm[place:].sum(axis=0) / np.maximum(after, 1)[:, None]
        - grid.deviations_mm[:place].sum(axis=0) / np.maximum(before, 1)[:, None]
    )
    return np.where(both[:, None], step, 0.0)


def common_share(grid: CycleGrid) -> float | None:
    """Return the share of the poses' slow motion that is common to all of them; None without such motion."""
    modes = _cosines(len(grid.numbers))
    common = _slow(modes, grid.common_whitened[:, None])
    total = _slow(modes, grid.whitened[:, (grid.weights != 0.0).any(axis=(1, 2))])
    if total <= 0.0:
        return None
    return float(np.clip(common / total, 0.0, 1.0))


def _slow(modes: Float[np.ndarray, "n m"], z: Float[np.ndarray, "n c 3"]) -> float:
    """Return the energy of the slow modes less what white scatter has there, by the fast ones."""
    energy = np.einsum("nm,nci->mci", modes, z)
    each = np.einsum("mci,mci->m", energy, energy)
    low = max(3, len(each) // _LOW_MODES)
    # As the spectra of a trend and of a step fall off.
    weight = np.arange(1.0, low + 1.0) ** -2
    return float(weight @ (each[:low] - each[low:].mean()))


def _cosines(n: int) -> Float[np.ndarray, "n m"]:
    k = np.arange(1, n)
    return np.asarray(np.sqrt(2.0 / n) * np.cos(np.pi * (np.arange(n)[:, None] + 0.5) * k / n))


def _line(n: int, seen: Bool[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " n"], float]:
    """Return the weights of the cycles in the change over all n, and the sum of their squares."""
    t = np.arange(n, dtype=float)
    tau = np.where(seen, t - t[seen].mean(), 0.0) if seen.any() else np.zeros(n)
    square = float(tau @ tau)
    if square == 0.0:
        return np.zeros(n), 0.0
    return tau * (n - 1.0) / square, (n - 1.0) ** 2 / square


def _common_covariance(grid: CycleGrid, step: int | None = None) -> Float[np.ndarray, "3 3"]:
    """Return the covariance of a cycle of the common series by successive differences, which no slow motion enters;
    the difference at the row of a step does not count.

    J. von Neumann et al., Ann. Math. Stat. 12 (1941) 153-162, doi:10.1214/aoms/1177731746.
    """
    steps = np.diff(grid.common_mm, axis=0)
    if step is not None and len(steps) > 1:
        steps = np.delete(steps, step - 1, axis=0)
    return np.asarray(steps.T @ steps / (2.0 * max(len(steps), 1)))


def _uncertainty(variance: float, covariance: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    return np.asarray(np.sqrt(variance * np.maximum(np.diag(covariance), 0.0)))
