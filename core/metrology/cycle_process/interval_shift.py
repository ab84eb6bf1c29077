"""What a process of cycles does to the interval of a figure, against independent Gaussian cycles.

**Correlated cycles.** The interval of a figure is the figure over the quantiles of figure / long-run figure. These are
simulated for n cycles of the pose's own shape of scatter, twice with the same random numbers: as independent Gaussian
cycles, and by the process, each draw with φ from its posterior. 3 S has no shape, and the same way for tails, too.

**Heavy tails.** A figure of few cycles with heavy tails knows less of the long-run figure than the cycles do. RP_l has
the posterior of its long-run value (`tail_shift`), as if cycles were Gaussian and by the process.

Either way the logarithms of two pairs of quantiles differ by a shift, which is zero for independent Gaussian cycles:
their interval, which knows that shapes are estimated, stays what it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from core.metrology.cycle_process.heavy_tails import TAIL_DEGREES
from core.metrology.cycle_process.lag_correlation import CORRELATIONS
from core.metrology.cycle_process.process import CycleProcess, main_axes
from core.metrology.cycle_process.tail_shift import tail_shift
from core.metrology.iso9283 import rp_of_lengths
from core.metrology.rp_distribution import CONFIDENCE, long_run_rp

_SEED = 92831
_MIN_DRAWS, _MAX_DRAWS = 400, 4000
_CELLS = 6_000_000
_LEAST_WEIGHT = 0.005
"""Alternatives of less probability than this change no quantile visibly."""


@dataclass(frozen=True, slots=True)
class IntervalShift:
    """By how much the logarithms of the bounds move."""

    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]


def shift_of_rp(process: CycleProcess, deviations: Sequence[Float[np.ndarray, "_ 3"]]) -> IntervalShift:
    """Return the shift of RP_l's interval for poses of these deviations, all of n ≥ 2 cycles.

    Parameters
    ----------
    deviations
        Of the cycles from their mean, mm, scaled to equal variance where the instrument's noise differs.
    """
    low, high = np.zeros((2, len(deviations)))
    if _matters(process):
        places: dict[int, list[int]] = {}
        axes = [main_axes(one) for one in deviations]
        for i, x in enumerate(axes):
            places.setdefault(x.shape[1], []).append(i)
        for d, members in places.items():
            if d > 0:
                x = np.stack([axes[i] for i in members])
                shift = _of_correlation if process.correlations.any() else tail_shift
                low[members], high[members] = shift(process, x)
    return IntervalShift(low, high)


def _of_correlation(
    process: CycleProcess, x: Float[np.ndarray, "k n d"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Compare the quantiles of figure over long-run figure."""
    poses, n, d = x.shape
    base, other, _ = _series(process, n, _draws(poses * n))
    spectra = np.linalg.eigvalsh(np.swapaxes(x, 1, 2) @ x)[:, ::-1]
    low, high = np.empty((2, poses))
    for i, shape in enumerate(spectra / spectra[:, :1]):
        low[i], high[i] = _moved(_rp(base[..., :d], shape), _rp(other[..., :d], shape))
    return low, high


def shift_of_three_sigma(process: CycleProcess, cycles: int) -> IntervalShift:
    """Return the shift of the interval of 3 S."""
    if not _matters(process):
        return IntervalShift(np.zeros(1), np.zeros(1))
    low, high = _of_three_sigma(tuple(process.tails.tolist()), tuple(process.correlations.tolist()), cycles)
    return IntervalShift(np.array([low]), np.array([high]))


@lru_cache(maxsize=256)
def _of_three_sigma(
    tails: tuple[float, ...], correlations: tuple[float, ...], cycles: int
) -> tuple[float, float]:
    """Compare the quantiles of S over long-run S; the same for every distance of a session."""
    base, other, variance = _series(
        CycleProcess(np.array(tails), np.array(correlations)), cycles, _draws(cycles)
    )
    gaussian = 0.5 * np.log(base[..., 0].var(axis=1, ddof=1))
    return _moved(gaussian, 0.5 * np.log(other[..., 0].var(axis=1, ddof=1) / variance))


def ratio_draws(process: CycleProcess, x: Float[np.ndarray, "n d"], trials: int) -> Float[np.ndarray, " b"]:
    """Return draws of RP_l of n cycles over its long-run value, by the process and a pose's own shape of scatter.

    They are `trials`, fewer of very many cycles, whose ratio scatters little.
    """
    n, d = x.shape
    _, other, variance = _series(process, n, min(trials, max(_CELLS // n, _MIN_DRAWS)))
    spectrum = np.zeros(3)
    spectrum[:d] = np.linalg.eigvalsh(x.T @ x)[::-1]
    logs = _rp(other[..., :d], spectrum[:d]) - 0.5 * np.log(variance)
    return np.asarray(np.exp(logs) / long_run_rp(spectrum))


def _matters(process: CycleProcess) -> bool:
    return process.independent_gaussian < 1.0 - _LEAST_WEIGHT


def _draws(cells: int) -> int:
    return int(np.clip(_CELLS // cells, _MIN_DRAWS, _MAX_DRAWS))


def _moved(gaussian: Float[np.ndarray, " b"], found: Float[np.ndarray, " b"]) -> tuple[float, float]:
    tail = (1.0 - CONFIDENCE) / 2.0
    quantiles = [1.0 - tail, tail]
    low, high = np.quantile(gaussian, quantiles) - np.quantile(found, quantiles)
    return float(low), float(high)


def unit_series(process: CycleProcess, cycles: int, draws: int) -> Float[np.ndarray, "b n 3"]:
    """Return draws of n cycles in three independent directions, of unit variance where the process is Gaussian."""
    return _drawn(process, cycles, draws)[1]


def _series(
    process: CycleProcess, cycles: int, draws: int
) -> tuple[Float[np.ndarray, "b n 3"], Float[np.ndarray, "b n 3"], Float[np.ndarray, " b"]]:
    """Return unit deviations from the mean as Gaussian and by the process, and the variance of each draw's process."""
    normal, other, variance = _drawn(process, cycles, draws)
    return _about_mean(normal), _about_mean(other), variance


def _drawn(
    process: CycleProcess, cycles: int, draws: int
) -> tuple[Float[np.ndarray, "b n 3"], Float[np.ndarray, "b n 3"], Float[np.ndarray, " b"]]:
    """Return cycles as Gaussian and by the process with the same random numbers, and the variance of each draw's
    process.

    Alternatives have their share of the draws, in an order that is the same for all sessions.
    """
    # Takes half a second to load, which every process of a service would pay.
    from scipy.signal import lfilter

    rng = np.random.default_rng([_SEED, cycles])
    normal = rng.standard_normal((draws, cycles, 3))
    values = np.concatenate([[0.0], TAIL_DEGREES, CORRELATIONS])
    weights = np.concatenate([[process.independent_gaussian], process.tails, process.correlations])
    kind = np.searchsorted(np.cumsum(weights / weights.sum()), (np.arange(draws) + 0.5) / draws)
    kind = np.minimum(kind, len(values) - 1)
    other = normal.copy()
    variance = np.ones(draws)
    for k in np.unique(kind[kind > 0]):
        chosen = kind == k
        if k <= len(TAIL_DEGREES):
            nu = float(values[k])
            weight = rng.chisquare(nu, (int(chosen.sum()), cycles, 1)) / nu
            other[chosen] = normal[chosen] / np.sqrt(weight)
            variance[chosen] = nu / (nu - 2.0)
        else:
            phi = float(values[k])
            driven = normal[chosen] * np.sqrt(1.0 - phi * phi)
            driven[:, 0] = normal[chosen][:, 0]
            other[chosen] = lfilter([1.0], [1.0, -phi], driven, axis=1)
    return normal, other, variance


def _about_mean(x: Float[np.ndarray, "b n 3"]) -> Float[np.ndarray, "b n 3"]:
    return np.asarray(x - x.mean(axis=1, keepdims=True))


def _rp(x: Float[np.ndarray, "b n d"], shape: Float[np.ndarray, " d"]) -> Float[np.ndarray, " b"]:
    return np.asarray(np.log(rp_of_lengths(np.sqrt((x * x) @ shape))))
