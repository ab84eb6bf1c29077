"""Intervals of RP_l where cycles are correlated or have heavy tails: coverage and width."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import gammaln

from benchmarks.table import Row
from benchmarks.trust.steadiness import Process, correlated, gaussian, series_of, student
from core.metrology import (
    CORRELATED,
    PoseCycles,
    assess_repeatability,
    assess_steadiness,
    estimate_process,
    long_run_rp,
    mean_length,
)

SHAPES = {"sphere": (1.0, 1.0, 1.0), "egg": (1.0, 0.5, 0.2), "needle": (1.0, 4e-4, 4e-4)}
_PROCESSES: dict[str, tuple[Process, float | None]] = {
    "Gauss": (gaussian, None),
    "AR(1) .3": (correlated(0.3), None),
    "AR(1) .8": (correlated(0.8), None),
    "Student t4": (student, 4.0),
}


def trust_rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    sessions = 3 if quick else 30
    for name, (process, nu) in _PROCESSES.items():
        for n in (30, 10):
            found = {
                shape: _measured(process, nu, n, np.array(spectrum), seeds, sessions)
                for shape, spectrum in SHAPES.items()
            }
            covered = 100.0 * float(np.mean([one[0] for one in found.values()]))
            width = float(np.mean([one[1] for one in found.values()]))
            count = len(SHAPES) * len(seeds) * sessions
            listed = ", ".join(f"{shape} {100.0 * one[0]:.1f}" for shape, one in found.items())
            note = f"{count} sessions of five poses: {listed}; median width {width:.2f} of the figure"
            yield Row.within(
                f"coverage of 95 % intervals of RP_l, {name}, n {n}", covered, 93.0, 97.0, "%", note
            )


def _measured(
    process: Process, nu: float | None, n: int, spectrum: np.ndarray, seeds: Sequence[int], sessions: int
) -> tuple[float, float]:
    """Return the share of intervals that contain the long-run RP_l, and their median width over it."""
    inside, widths = [], []
    for seed in seeds:
        for k in range(sessions):
            x = process(np.random.default_rng([seed, n, k, 7]), n) * np.sqrt(spectrum)
            series = series_of(x)
            steadiness = assess_steadiness(series)
            assert steadiness.p_values is not None
            model = estimate_process(
                [one.positions_mm - one.positions_mm.mean(axis=0) for one in series],
                [one.cycles for one in series],
                steadiness.p_values.autocorrelation <= CORRELATED,
            )
            truth = _long_run(spectrum, nu)
            for found in assess_repeatability(
                [PoseCycles(one.positions_mm) for one in series], process=model
            ):
                interval = found.interval.position_mm
                assert interval is not None
                low, high = interval
                inside.append(low <= truth <= high)
                widths.append((high - low) / truth)
    return float(np.mean(inside)), float(np.median(widths))


def _long_run(spectrum: np.ndarray, nu: float | None) -> float:
    """Return the long-run RP_l of cycles with this scale, Gaussian or Student t."""
    scale = spectrum * (0.1 / 3.616) ** 2
    if nu is None:
        return float(long_run_rp(scale))
    m = float(mean_length(scale)) * np.sqrt(0.5 * nu) * np.exp(gammaln(0.5 * (nu - 1.0)) - gammaln(0.5 * nu))
    return float(m + 3.0 * np.sqrt(scale.sum() * nu / (nu - 2.0) - m * m))
