"""Repeatability from rendered images and from poses alone: floors, coverage, bias and speed, against known truth."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import rendered_sessions
from benchmarks.rendered_sessions import side_by_side
from benchmarks.table import Row
from core.geometry import rpy_to_rotation
from core.metrology import (
    COMPONENTS,
    IntervalEstimate,
    PoseCycles,
    angles_from_vectors,
    assess_radial,
    assess_repeatability,
    assess_three_sigma,
    eigenvalues,
    long_run_rp,
    noise_only_lengths,
    rp_sampling_distribution,
)

SHAPES = {
    "sphere": (1.0, 1.0, 1.0),
    "egg": (1.0, 0.5, 0.2),
    "flat": (1.0, 1.0, 1e-4),
    "cigar": (1.0, 0.09, 0.09),
    "strip": (1.0, 0.09, 0.0081),
    "needle": (1.0, 1e-4, 1e-4),
}
NOISE_SHAPES = {"sphere": (1.0, 1.0, 1.0), "along": (1.0, 1e-4, 1e-4), "across": (1e-4, 1e-4, 1.0)}


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    yield from rendered_sessions.floors(seeds, quick)
    yield from _coverage_of_poses(seeds, 200 if quick else 1000)
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
    yield from _biases(seeds, quick)
    for poses, cycles in ((333, 30), (5, 2000)):
        yield _speed(poses, cycles)


@dataclass(frozen=True)
class _Case:
    """Poses of n cycles whose noise floor is `share` of what they read."""

    n: int
    share: float
    seed: int
    trials: int


def _coverage_of_poses(seeds: list[int], trials: int) -> Iterator[Row]:
    """Six-dimensional poses through the door: every figure's interval against its long-run value."""
    cases = [_Case(n, share, seed, trials) for n in (10, 30) for share in (0.0, 0.5) for seed in seeds]
    with side_by_side() as pool:
        inside = dict(zip(cases, pool.map(_covered, cases), strict=True))
    for n in (10, 30):
        for share in (0.0, 0.5):
            found = np.mean([inside[case] for case in cases if (case.n, case.share) == (n, share)], axis=0)
            listed = ", ".join(f"{name} {100 * v:.1f}" for name, v in zip(COMPONENTS, found, strict=True))
            floor = "no noise" if share == 0.0 else f"floor {share:g} of the reading"
            for end in (min, max):
                what = f"coverage of 95 % intervals, n {n}, {floor}, {end.__name__} of seven figures"
                yield Row.within(
                    what,
                    100.0 * float(end(found)),
                    93.0,
                    97.0,
                    "%",
                    f"{trials * len(seeds):,} poses: {listed}",
                )


def _covered(case: _Case) -> np.ndarray:
    """Return the share of intervals that hold the long-run value, figure by figure.

    Robot and noise are correlated six-dimensional Gaussians, drawn anew for every hundred poses.
    """
    rng = np.random.default_rng([case.seed, case.n, round(10 * case.share), 5])
    mean = rpy_to_rotation(np.array([0.3, math.radians(40.0), -2.0]))
    J = np.eye(6)
    J[3:, 3:] = angles_from_vectors(mean)
    inside = np.zeros((0, len(COMPONENTS)))
    for _ in range(case.trials // 100):
        unit = np.array([0.03] * 3 + [2e-4] * 3)[:, None]
        robot, noise = (root @ root.T for root in unit * rng.normal(size=(2, 6, 6)))
        total = robot
        if case.share:
            # The reading's square is the sum of robot's and noise's, as near as it takes to set the floor.
            size = [float(long_run_rp(eigenvalues(C[:3, :3]))) for C in (robot, noise)]
            noise = noise * (size[0] / size[1]) ** 2 * case.share**2 / (1.0 - case.share**2)
            total = robot + noise
        stated = np.repeat(noise[None], case.n, axis=0) if case.share else np.zeros((case.n, 6, 6))
        draws = rng.standard_normal((100, case.n, 6)) @ np.linalg.cholesky(total).T
        turns = (
            Rotation.from_rotvec(draws[..., 3:].reshape(-1, 3)).as_matrix().reshape(100, case.n, 3, 3) @ mean
        )
        results = assess_repeatability(
            [PoseCycles(p, R, stated) for p, R in zip(draws[..., :3], turns, strict=True)]
        )
        seen = J @ total @ J.T
        truth = [float(long_run_rp(eigenvalues(total[:3, :3]))), *(3.0 * np.sqrt(np.diag(seen)))]
        bounds = np.array([[interval for _, interval in r.interval.items()] for r in results], dtype=float)
        inside = np.vstack([inside, (bounds[..., 0] <= truth) & (truth <= bounds[..., 1])])
    return np.asarray(inside.mean(axis=0))


def _read(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    d = positions - positions.mean(axis=1, keepdims=True)
    lengths = np.linalg.norm(d, axis=2)
    n = positions.shape[1]
    return lengths.mean(axis=1) + 3.0 * lengths.std(axis=1, ddof=1), d.transpose(0, 2, 1) @ d / (n - 1)


def _assess(reading: np.ndarray, covariance: np.ndarray, noise: np.ndarray, n: int) -> IntervalEstimate:
    matrices = np.repeat(np.diag(noise)[None], len(reading), axis=0)
    still = np.tile(noise_only_lengths(matrices[:1].repeat(n, axis=0)), (len(reading), 1))
    return assess_radial(
        reading, covariance, matrices, np.zeros(len(reading)), still, np.full(len(reading), float(n))
    )


def _coverage(
    n: int, shape: tuple[float, float, float], trials: int, seeds: list[int]
) -> tuple[float, float, float]:
    spectrum = np.array(shape)
    truth = float(long_run_rp(spectrum))
    inside = []
    for seed in seeds:
        rng = np.random.default_rng([seed, n])
        reading, covariance = _read(rng.standard_normal((trials, n, 3)) * np.sqrt(spectrum))
        law = rp_sampling_distribution(
            np.maximum(np.linalg.eigvalsh(covariance)[:, ::-1], 0.0), np.full(trials, float(n))
        )
        low, high = law.interval(reading)
        variance = np.einsum("tii->ti", covariance)
        nothing = np.zeros_like(variance)
        axis = assess_three_sigma(variance, nothing, nothing, np.full(trials, float(n)))
        inside.append(
            (
                np.mean((low <= truth) & (truth <= high)),
                np.mean((axis.low[:, 0] <= 3.0) & (axis.high[:, 0] >= 3.0)),
                reading.mean() / truth - 1.0,
            )
        )
    covered, covered_axis, offset = np.mean(inside, axis=0)
    return float(covered), float(covered_axis), float(offset)


@dataclass(frozen=True)
class _Pair:
    """A robot whose true RP_l is `ratio` times the floor, scatter and noise of these shapes."""

    n: int
    ratio: float
    robot: str
    noise: str
    trials: int
    seeds: tuple[int, ...]


def _biases(seeds: list[int], quick: bool) -> Iterator[Row]:
    """Compare raw and corrected RP_l with what a perfect instrument would have read in the same cycles."""
    # At the floor a corrected value scatters by a sixth: so many poses determine its bias to .2 %.
    few, many = (200, 200) if quick else (500, 2000)
    for n, ratio in ((30, 1.0), (30, 2.0), (10, 1.0), (10, 2.0)):
        trials = many if (n, ratio) == (30, 1.0) else few
        pairs = [_Pair(n, ratio, r, s, trials, tuple(seeds)) for r in SHAPES for s in NOISE_SHAPES]
        with side_by_side() as pool:
            raw, corrected, u = np.array(list(pool.map(_bias, pairs))).T
        at = int(np.argmax(np.abs(corrected)))
        case = f"true RP {ratio:g} × floor, n {n}"
        note = (
            f"{pairs[at].robot} robot, noise {pairs[at].noise}, known to {u[at]:.2f} %; {len(pairs)} pairs of "
            f"shapes × {trials * len(seeds):,} poses; raw reads {raw.max():+.1f} % at worst"
        )
        what = f"bias of corrected RP_l, {case}, worst pair"
        if n == 30:
            yield Row.within(what, float(corrected[at]), -2.0, 2.0, "%", note)
        else:
            yield Row.context(what, float(corrected[at]), "%", note)


def _bias(pair: _Pair) -> tuple[float, float, float]:
    """Return the raw and the corrected bias and the latter's standard error, %; clipped at raw, as it is reported."""
    robot = _of_reading(np.array(SHAPES[pair.robot]), pair.ratio)
    noise = _of_reading(np.array(NOISE_SHAPES[pair.noise]), 1.0)
    true, raw, corrected = [], [], []
    for seed in pair.seeds:
        rng = np.random.default_rng([seed, pair.n, 1])
        cycles = rng.standard_normal((pair.trials, pair.n, 3)) * np.sqrt(robot)
        noisy = cycles + rng.standard_normal((pair.trials, pair.n, 3)) * np.sqrt(noise)
        reading, covariance = _read(noisy)
        true.append(_read(cycles)[0])
        raw.append(reading)
        corrected.append(np.minimum(_assess(reading, covariance, noise, pair.n).corrected, reading))
    t, r, c = (np.concatenate(values) for values in (true, raw, corrected))
    error = float(np.std(c - t)) / math.sqrt(len(t))
    mean = float(t.mean())
    return (
        100.0 * (float(r.mean()) / mean - 1.0),
        100.0 * (float(c.mean()) / mean - 1.0),
        100.0 * error / mean,
    )


def _of_reading(spectrum: np.ndarray, reading: float) -> np.ndarray:
    return spectrum * (reading / float(long_run_rp(np.sort(spectrum)[::-1]))) ** 2


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
