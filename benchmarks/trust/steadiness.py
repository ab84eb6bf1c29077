"""Steadiness of cycles: false alarms of the test, its power, and whether what moved is attributed rightly."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from benchmarks.table import Row
from core.metrology import Attribution, PoseSeries, Steadiness, assess_steadiness

SIGMA_MM = 0.1 / 3.616
"""A sphere of this standard deviation has RP_l .1 mm."""
POSES = 5
Cycles = np.ndarray
Process = Callable[[np.random.Generator, int], Cycles]


def trust_rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    sessions = 20 if quick else 200
    for name, process in _STEADY.items():
        for n in (10, 30):
            found = list(_assessed(process, n, seeds, sessions))
            what = f"`not_steady` per session of steady cycles, {name}, {POSES} × {n}"
            rate = 100.0 * float(np.mean([one.steady is False for one in found]))
            yield Row.at_most(what, rate, 2.0, "%", f"{len(found)} sessions; 1 % by construction")
    sessions = 10 if quick else 50
    for name, (process, n, attribution) in _MOVING.items():
        found = list(_assessed(process, n, seeds, sessions))
        note = f"{len(found)} sessions of {POSES} × {n}"
        power = float(np.mean([one.steady is False for one in found]))
        yield Row.at_least(f"`not_steady`, {name}", power, 0.98, "", note)
        if attribution is not None:
            right = float(np.mean([one.attribution is attribution for one in found]))
            yield Row.at_least(f"attributed as {attribution}, {name}", right, 0.95, "", note)
    yield from _speed()


def series_of(x: Cycles) -> list[PoseSeries]:
    """Return the series of each pose, its cycles numbered from 1."""
    return [PoseSeries(x[:, i], np.arange(1, len(x) + 1)) for i in range(x.shape[1])]


def gaussian(rng: np.random.Generator, n: int) -> Cycles:
    return SIGMA_MM * rng.standard_normal((n, POSES, 3))


def student(rng: np.random.Generator, n: int) -> Cycles:
    return gaussian(rng, n) / np.sqrt(rng.chisquare(4.0, (n, POSES, 1)) / 4.0)


def correlated(phi: float) -> Process:
    def make(rng: np.random.Generator, n: int) -> Cycles:
        x = gaussian(rng, n)
        for t in range(1, n):
            x[t] = phi * x[t - 1] + np.sqrt(1.0 - phi * phi) * x[t]
        return x

    return make


def needles(rng: np.random.Generator, n: int) -> Cycles:
    return gaussian(rng, n) * np.array([1.0, 0.02, 0.02])


def _drift(length_mm: float, common: bool) -> Process:
    def make(rng: np.random.Generator, n: int) -> Cycles:
        v = rng.standard_normal((1 if common else POSES, 3))
        v *= length_mm / np.linalg.norm(v, axis=1, keepdims=True)
        return gaussian(rng, n) + np.linspace(0.0, 1.0, n)[:, None, None] * v

    return make


def _two_points(rng: np.random.Generator, n: int) -> Cycles:
    x = gaussian(rng, n)
    v = rng.standard_normal(3)
    x[:, rng.integers(POSES)] += 9.0 * SIGMA_MM * (rng.random(n) < 0.5)[:, None] * v / np.linalg.norm(v)
    return x


_STEADY: dict[str, Process] = {"Gauss": gaussian, "Student t4": student, "needles": needles}
_MOVING: dict[str, tuple[Process, int, Attribution | None]] = {
    "drift of .2 mm of each pose in 40 cycles": (_drift(0.2, common=False), 40, Attribution.POSE_BY_POSE),
    "common drift of .05 mm in 30 cycles": (_drift(0.05, common=True), 30, Attribution.COMMON),
    "AR(1) .3": (correlated(0.3), 30, None),
    "AR(1) .8": (correlated(0.8), 30, Attribution.POSE_BY_POSE),
    "two points 9 σ apart": (_two_points, 30, None),
}


def _assessed(process: Process, n: int, seeds: Sequence[int], sessions: int) -> Iterator[Steadiness]:
    for seed in seeds:
        for k in range(sessions):
            yield assess_steadiness(series_of(process(np.random.default_rng([seed, n, k]), n)))


def _speed() -> Iterator[Row]:
    for poses, n, limit in ((5, 30, 0.1), (333, 30, 0.4)):
        x = np.random.default_rng(0).standard_normal((n, poses, 3))
        times = []
        for _ in range(5):
            start = time.process_time()
            assess_steadiness(series_of(x))
            times.append(time.process_time() - start)
        yield Row.at_most(
            f"test of {poses} poses × {n} cycles",
            float(np.median(times)),
            limit,
            "s",
            "processor time, median of 5",
        )
