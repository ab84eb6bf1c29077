"""Noise floor and verdict where noise is not white: against what a robot at rest reads, and one that moves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.table import Row
from core.metrology import Verdict, eigenvalues, long_run_rp
from core.session import assess_repeatability, estimate_session
from core.targets import TargetSpec
from tests.support.simulation.correlated_noise import (
    DISTURBANCES,
    Noise,
    estimated,
    figures,
    gaussian_field,
    noisy_session,
    row_wave,
    session_data,
    white,
)

SESSIONS = 4
"""Sessions of 5 poses × 30 cycles for each seed and disturbance."""
SMALL_SESSIONS = 84
"""Small sessions for each disturbance, over all seeds: over a thousand in all."""
SMALL_BOARD = TargetSpec("chessboard", 9, 6, 30.0)
MOVING = {"white": white(), "field of 2 squares": gaussian_field(2.0), "wave of .5 H": row_wave(0.5)}
READING_OVER_FLOOR = (3.5, 4.0, 5.0)
"""Where the verdict `robot`, which asks for 4, is won or lost."""
TWIN_CYCLES = 150


def trust_rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    """Yield what the floor is over what was read, false verdicts, and the power of the verdict `robot`."""
    sessions = 1 if quick else SESSIONS
    claims = still = 0
    for name, noise in DISTURBANCES.items():
        floors, readings, scatters, shown = [], [], [], []
        for seed in seeds:
            for k in range(sessions):
                session = noisy_session(np.random.default_rng([seed, k, 1]), noise)
                estimate = estimated(session)
                found = figures(session, estimate)
                label = np.array(session.labels)[estimate.images]
                scatters.append(float(np.trace(estimate.scatter[:, :3, :3].mean(axis=0))))
                shown.append(
                    float(
                        np.mean(
                            [np.trace(np.cov(estimate.positions_mm[label == one].T)) for one in set(label)]
                        )
                    )
                )
                floors += [row.noise_floor.position_mm or math.nan for row in found]
                readings += [row.repeatability.position_mm or math.nan for row in found]
                claims += sum(row.verdict == Verdict.ROBOT for row in found)
                still += len(found)
        note = f"robot at rest, {len(readings)} poses × 30 images of 14 × 10 points, pooled"
        value = float(np.sum(floors) / np.sum(readings))
        rms = math.sqrt(float(np.sum(scatters) / np.sum(shown)))
        yield Row.within(
            f"floor stated ÷ read, {name}", value, 0.9, 1.15, "", f"{note}; rms stated ÷ shown {rms:.2f}"
        )
    yield Row.at_most("verdict robot where nothing moved", claims, 0, "", f"of {still} poses")
    sessions = 2 if quick else max(SMALL_SESSIONS // len(seeds), 1)
    yield from _burst_rows(seeds, sessions)
    claims = still = 0
    for noise in DISTURBANCES.values():
        for seed in seeds:
            for k in range(sessions):
                rng = np.random.default_rng([seed, k, 3])
                session = noisy_session(rng, noise, poses=3, cycles=10, target=SMALL_BOARD)
                claims += any(row.verdict == Verdict.ROBOT for row in figures(session, estimated(session)))
                still += 1
    note = f"of {still} sessions of 3 poses × 10 images of 9 × 6 points, {len(DISTURBANCES)} disturbances"
    yield Row.at_most("sessions with a verdict robot where nothing moved", claims, 0, "", note)
    for name, noise in MOVING.items():
        stated, known = _power(noise, seeds, sessions)
        note = f"share of poses called robot: {stated:.2f}; with the floor exactly known {known:.2f}"
        what = f"power of robot less that with the floor known, {name}"
        yield Row.within(what, stated - known, -0.1, 0.1, "", note)


def _burst_rows(seeds: Sequence[int], sessions: int) -> Iterator[Row]:
    """Yield what the floor by the images within stops is over that of a long twin at rest, whatever the noise."""
    for name, noise in DISTURBANCES.items():
        stated, true = [], []
        degraded = 0
        for seed in seeds:
            for k in range(max(sessions // 20, 1)):
                session = noisy_session(np.random.default_rng([seed, k, 4]), noise, burst=2, robot_mm=0.03)
                data = session_data(session, session.camera)
                assessed = assess_repeatability(data, estimate_session(data, "given"))
                found = assessed.bursts
                degraded += sum(len(row.excluded) for row in assessed.poses)
                twin = noisy_session(np.random.default_rng([seed, k, 4]), noise, cycles=TWIN_CYCLES)
                at_rest = estimated(twin, "given")
                label = np.array(twin.labels)[at_rest.images]
                for pose, one in enumerate(np.unique(label)):
                    scatter = np.cov(at_rest.positions_mm[label == one].T) / 2.0
                    floor = found.poses[f"P{pose}"].noise_floor if found is not None else None
                    stated.append((floor and floor.position_mm) or math.nan)
                    true.append(float(long_run_rp(eigenvalues(scatter))))
        note = f"moving robot, {len(true)} poses × 30 stops × 2 images; true: {TWIN_CYCLES} images of one at rest"
        what, value = f"floor by bursts ÷ true, {name}", float(np.sum(stated) / np.sum(true))
        if degraded:
            # The floor is that of the images that count; the twin at rest has the others, too.
            yield Row.context(
                what, value, "", f"{note}; {degraded} images of the first are degraded, and do not count"
            )
        else:
            yield Row.within(what, value, 0.9, 1.15, "", note)


def _power(noise: Noise, seeds: Sequence[int], sessions: int) -> tuple[float, float]:
    """Return the share of poses with the verdict `robot`, by the stated floor and by that of a twin at rest."""
    by_stated, by_known = [], []
    for seed in seeds:
        for k, ratio in enumerate(READING_OVER_FLOOR[:sessions]):
            twin = noisy_session(np.random.default_rng([seed, k, 2]), noise, cycles=TWIN_CYCLES)
            found = estimated(twin, "given")
            label = np.array(twin.labels)[found.images]
            scatter = [np.cov(found.positions_mm[label == one].T) for one in np.unique(label)]
            known = np.array([float(long_run_rp(eigenvalues(one))) for one in scatter])
            # RP of a sphere is 3.6 of its deviations along an axis.
            robot_mm = float(np.median(known)) * math.sqrt(ratio**2 - 1.0) / float(long_run_rp(np.ones(3)))
            session = noisy_session(np.random.default_rng([seed, k, 2]), noise, robot_mm=robot_mm)
            for row, floor in zip(figures(session, estimated(session)), known, strict=True):
                by_stated.append(row.verdict == Verdict.ROBOT)
                by_known.append((row.repeatability.position_mm or 0.0) >= 4.0 * floor)
    return float(np.mean(by_stated)), float(np.mean(by_known))
