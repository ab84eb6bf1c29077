"""Repeatability from poses alone: coverage, bias, floors and speed, against drawn truth."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator

import numpy as np

from benchmarks.table import Row
from core.metrology import PoseCycles, assess_repeatability
from core.metrology.radial import long_run_reading
from core.metrology.uncertainty import Assessed, assess_radial, assess_three_sigma, still_lengths

SHAPES = {
    "sphere": (1.0, 1.0, 1.0),
    "egg": (1.0, 0.5, 0.2),
    "flat": (1.0, 1.0, 1e-4),
    "cigar": (1.0, 0.09, 0.09),
    "strip": (1.0, 0.09, 0.0081),
    "needle": (1.0, 1e-4, 1e-4),
}


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    trials = 500 if quick else 2000
    for n in (10, 30, 100):
        note = f"{len(SHAPES)} shapes of scatter × {trials * len(seeds):,} poses of {n} cycles"
        inside = [_coverage(n, shape, trials, seeds) for shape in SHAPES.values()]
        for end in (min, max):
            value = 100.0 * end(pair[0] for pair in inside)
            what = f"coverage of 95 % intervals of RP_l, n {n}, {end.__name__} over shapes"
            yield Row.within(what, value, 93.0, 97.0, "%", note)
        # An axis does not know the shape of the rest: the same draws, the same figure.
        value = 100.0 * inside[0][1]
        yield Row.within(f"coverage of 95 % intervals of 3 S, n {n}", value, 93.0, 97.0, "%", note)
        for end in (min, max):
            value = 100.0 * end(pair[2] for pair in inside)
            what = f"mean reading RP_l less its long-run value, n {n}, {end.__name__} over shapes"
            yield Row.context(what, value, "%", note)
    for n, ratio in ((30, 1.0), (30, 2.0), (10, 1.0), (10, 2.0)):
        yield from _bias(n, ratio, trials, seeds, goal=n == 30)
    for poses, cycles in ((333, 30), (5, 2000)):
        yield _speed(poses, cycles)


def _read(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    d = positions - positions.mean(axis=1, keepdims=True)
    lengths = np.linalg.norm(d, axis=2)
    n = positions.shape[1]
    return lengths.mean(axis=1) + 3.0 * lengths.std(axis=1, ddof=1), d.transpose(0, 2, 1) @ d / (n - 1)


def _assess(reading: np.ndarray, covariance: np.ndarray, noise: np.ndarray, n: int) -> Assessed:
    matrices = np.repeat(np.diag(noise)[None], len(reading), axis=0)
    still = np.tile(still_lengths(matrices[:1].repeat(n, axis=0)), (len(reading), 1))
    return assess_radial(
        reading, covariance, matrices, np.zeros(len(reading)), still, np.full(len(reading), float(n))
    )


def _coverage(
    n: int, shape: tuple[float, float, float], trials: int, seeds: list[int]
) -> tuple[float, float, float]:
    spectrum = np.array(shape)
    truth = float(long_run_reading(spectrum))
    inside = []
    for seed in seeds:
        rng = np.random.default_rng([seed, n])
        reading, covariance = _read(rng.standard_normal((trials, n, 3)) * np.sqrt(spectrum))
        radial = _assess(reading, covariance, np.zeros(3), n)
        variance = np.einsum("tii->ti", covariance)
        nothing = np.zeros_like(variance)
        axis = assess_three_sigma(variance, nothing, nothing, np.full(trials, float(n)))
        inside.append(
            (
                np.mean((radial.low <= truth) & (truth <= radial.high)),
                np.mean((axis.low[:, 0] <= 3.0) & (axis.high[:, 0] >= 3.0)),
                reading.mean() / truth - 1.0,
            )
        )
    covered, covered_axis, low = np.mean(inside, axis=0)
    return float(covered), float(covered_axis), float(low)


def _bias(n: int, ratio: float, trials: int, seeds: list[int], goal: bool) -> Iterator[Row]:
    """Compare raw and corrected RP_l with what a perfect instrument would have read in the same cycles."""
    raw, corrected = [], []
    for robot_shape in SHAPES.values():
        for noise_shape in ("sphere", "needle"):
            robot = _of_reading(np.array(robot_shape), ratio)
            noise = _of_reading(np.array(SHAPES[noise_shape]), 1.0)
            sums = np.zeros(3)
            for seed in seeds:
                rng = np.random.default_rng([seed, n, 1])
                true = rng.standard_normal((trials, n, 3)) * np.sqrt(robot)
                reading, covariance = _read(true + rng.standard_normal((trials, n, 3)) * np.sqrt(noise))
                result = _assess(reading, covariance, noise, n)
                sums += [_read(true)[0].sum(), reading.sum(), result.corrected.sum()]
            raw.append(100.0 * (sums[1] / sums[0] - 1.0))
            corrected.append(100.0 * (sums[2] / sums[0] - 1.0))
    worst = max(corrected, key=abs)
    case = f"true RP {ratio:g} × floor, n {n}"
    note = f"{len(raw)} pairs of shapes × {trials * len(seeds):,} poses; raw reads {max(raw):+.1f} % at worst"
    if goal:
        yield Row.within(f"bias of corrected RP_l, {case}, worst pair", worst, -2.0, 2.0, "%", note)
    else:
        yield Row.context(f"bias of corrected RP_l, {case}, worst pair", worst, "%", note)


def _of_reading(spectrum: np.ndarray, reading: float) -> np.ndarray:
    return spectrum * (reading / float(long_run_reading(spectrum))) ** 2


def _speed(poses: int, cycles: int) -> Row:
    rng = np.random.default_rng(0)
    covariance = np.repeat(np.diag([1e-5] * 3 + [1e-10] * 3)[None], cycles, axis=0)
    rotations = np.repeat(np.eye(3)[None], cycles, axis=0)
    session = [
        PoseCycles(rng.normal(scale=0.03, size=(cycles, 3)), rotations, covariance) for _ in range(poses)
    ]
    times = []
    for _ in range(7):
        start = time.perf_counter()
        assess_repeatability(session)
        times.append(time.perf_counter() - start)
    note = f"median of six; the first call of a process {times[0]:.2f} s"
    return Row.at_most(
        f"figures of {poses} poses × {cycles:,} cycles", float(np.median(times[1:])), 0.5, "s", note
    )
