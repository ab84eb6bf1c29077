"""Cycles that are named or do not count, stated movements, and decisions on a limit: how often each is wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from benchmarks.table import Row
from benchmarks.trust.steadiness import POSES, SIGMA_MM, Process, gaussian, needles, student
from core.metrology import (
    PoseCycles,
    PoseRepeatability,
    assess_repeatability,
    decide,
    drift,
    long_run_rp,
    repeatability_reading,
)
from core.session import assess_acceptance, estimate_session
from core.session import assess_repeatability as assess_session
from core.session.model import Datasheet
from core.targets import TargetSpec
from tests.support.simulation.correlated_noise import (
    NoisySession,
    gaussian_field,
    noisy_session,
    session_data,
    white,
)
from tests.support.simulation.session_cycles import NOISE, correlated, measured_session

BOARD = TargetSpec("chessboard", 9, 6, 30.0)
ROBOT_MM = 0.005
"""A robot steadier than its instrument is loud, so that a degraded image could matter."""
CYCLES = 12
DEGRADED_PX = 0.05
"""Deviation of the smooth pattern over three squares that a degraded image has beyond the noise of the others."""


def trust_rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    """Yield false alarms and power of the rules on outliers and images, errors of movements and of decisions."""
    yield from _outliers(seeds, 200 if quick else 2000 // len(seeds))
    yield from _images(seeds, 4 if quick else 300 // len(seeds))
    yield from _movements(seeds, 100 if quick else 2000 // len(seeds))
    yield from _decisions(seeds, 20 if quick else 600 // len(seeds))
    yield from _worst_pose(seeds, 10 if quick else 150 // len(seeds))


def _outliers(seeds: Sequence[int], sessions: int) -> Iterator[Row]:
    processes: dict[str, tuple[Process, float | None]] = {
        "Gauss": (gaussian, 5.0),
        "needles": (needles, 5.0),
        "Student t4": (student, None),
    }
    for name, (process, limit) in processes.items():
        for n in (10, 30):
            count = 0
            for seed in seeds:
                for k in range(sessions):
                    x = process(np.random.default_rng([seed, n, k, 9]), n)
                    figures = assess_repeatability([PoseCycles(x[:, i]) for i in range(POSES)])
                    count += any(one.outliers for one in figures)
            named = 100.0 * count / (len(seeds) * sessions)
            note = f"{len(seeds) * sessions} sessions of {POSES} poses; cycles named count all the same"
            what = f"sessions with a cycle named as outlier, {name}, n {n}"
            if limit is None:
                yield Row.context(what, named, "%", note)
            else:
                yield Row.at_most(what, named, limit, "%", note)
    for sigmas in (12.0, 25.0):
        alone, counted = [], []
        for seed in seeds:
            for k in range(sessions):
                rng = np.random.default_rng([seed, k, 10])
                cycles = gaussian(rng, 30)[:, 0]
                v = rng.standard_normal(3)
                cycles[rng.integers(30)] += sigmas * SIGMA_MM * v / np.linalg.norm(v)
                slipped_once = _assessed(cycles)
                alone.append(len(slipped_once.outliers) == 1)
                lengths = np.linalg.norm(cycles - cycles.mean(axis=0), axis=1)
                expected = float(lengths.mean() + 3.0 * lengths.std(ddof=1))
                counted.append(abs((slipped_once.repeatability.position_mm or 0.0) - expected) < 1e-9)
        note = f"{len(alone)} poses of 30 cycles, the deviation that of one axis"
        what = f"a slip of {sigmas:g} deviations"
        least = 90.0 if sigmas < 15.0 else 99.0
        yield Row.at_least(f"{what} is named", 100.0 * float(np.mean(alone)), least, "%", note)
        yield Row.at_least(f"{what} counts in RP_l", 100.0 * float(np.mean(counted)), 100.0, "%", note)


def _assessed(positions_mm: np.ndarray) -> PoseRepeatability:
    (figures,) = assess_repeatability([PoseCycles(positions_mm)])
    return figures


def _images(seeds: Sequence[int], sessions: int) -> Iterator[Row]:
    named = images = caught = excluded = slipped = 0
    count = len(seeds) * sessions
    for seed in seeds:
        for k in range(sessions):
            clean = _session(seed, k)
            named += _excluded(clean)
            images += len(clean.labels)
            at = int(np.random.default_rng([seed, k, 12]).integers(len(clean.labels)))
            caught += _excluded(_degraded(clean, at, np.random.default_rng([seed, k, 13])))
            slip_mm = float(np.random.default_rng([seed, k, 14]).uniform(0.1, 0.4))
            slipped += _excluded(_session(seed, k, slip=(at, slip_mm)))
            excluded += 1
    note = f"3 poses × {CYCLES} images of 9 × 6 points, robot of {1000 * ROBOT_MM:.0f} µm"
    yield Row.at_most("images of sound sessions that do not count", named, 0, "", f"of {images}; {note}")
    yield Row.at_most(
        "slips of .1 to .4 mm on sound images that do not count", slipped, 0, "", f"of {count}; {note}"
    )
    yield Row.context(
        "degraded images that do not count",
        100.0 * caught / excluded,
        "%",
        f"of {count}; a smooth pattern of {DEGRADED_PX} px; those whose pose moves little count rightly",
    )


def _session(seed: int, k: int, slip: tuple[int, float] | None = None) -> NoisySession:
    rng = np.random.default_rng([seed, k, 11])
    return noisy_session(rng, white(), poses=3, cycles=CYCLES, robot_mm=ROBOT_MM, target=BOARD, slip=slip)


def _degraded(session: NoisySession, image: int, rng: np.random.Generator) -> NoisySession:
    part = session.views.part(image)
    points = session.views.points_px.copy()
    points[part] += gaussian_field(3.0, DEGRADED_PX)(rng, points[part], 90.0, 1)[0]
    return dataclasses.replace(session, views=dataclasses.replace(session.views, points_px=points))


def _excluded(session: NoisySession) -> int:
    data = session_data(session)
    return sum(len(row.excluded) for row in assess_session(data, estimate_session(data)).poses)


def _movements(seeds: Sequence[int], poses: int) -> Iterator[Row]:
    """Yield how often a stated movement of the first to the last ten cycles contains the true one."""
    inside = []
    for seed in seeds:
        for k in range(poses):
            rng = np.random.default_rng([seed, k, 15])
            moved = rng.normal(0.0, 2.0 * SIGMA_MM, 3)
            x = gaussian(rng, 30)[:, 0] + np.repeat([0.0, 0.5, 1.0], 10)[:, None] * moved
            found = drift(x)
            error = np.hypot(found.blocks[0].standard_error_mm, found.blocks[-1].standard_error_mm)
            # Student's t of two means of ten with nine degrees of freedom each.
            inside.append(np.abs(found.shift_mm - moved) <= 2.10 * error)
    covered = 100.0 * float(np.mean(inside))
    note = f"{len(inside)} poses of 30 cycles, each axis, t of 18 degrees of freedom"
    yield Row.within("movement of drift: coverage of 95 % intervals", covered, 93.0, 97.0, "%", note)


def _decisions(seeds: Sequence[int], sessions: int) -> Iterator[Row]:
    """Yield how often a robot just beyond its limit passes, one just within fails, and clear cases are decided."""
    truth = float(long_run_rp(np.full(3, SIGMA_MM**2)))
    for n in (10, 30):
        found = {"pass": 0, "fail": 0}
        clear = {"pass": 0, "fail": 0}
        for seed in seeds:
            for k in range(sessions):
                x = gaussian(np.random.default_rng([seed, n, k, 16]), n)
                # The instrument's noise is known: of an unknown one nothing fails.
                known = np.broadcast_to(np.eye(3), (n, 3, 3)), np.broadcast_to(NOISE, (n, 6, 6))
                figures = assess_repeatability([PoseCycles(x[:, i], *known) for i in range(POSES)])
                readings = [repeatability_reading(one) for one in figures]
                decision = decide(truth, readings).decision
                if decision in found:
                    found[decision] += 1
                clear["pass"] += decide(2.0 * truth, readings).decision == "pass"
                clear["fail"] += decide(0.5 * truth, readings).decision == "fail"
        count = len(seeds) * sessions
        note = f"{count} robots of five equal poses, RP_l at the limit"
        yield Row.at_most(
            f"limit kept by nothing passes, n {n}", 100.0 * found["pass"] / count, 2.5, "%", note
        )
        yield Row.at_most(f"limit just kept fails, n {n}", 100.0 * found["fail"] / count, 4.0, "%", note)
        for what, share in clear.items():
            side = "half" if what == "pass" else "twice"
            name = f"RP_l of {side} the limit: decided as {what}, n {n}"
            if n == 30:
                yield Row.at_least(name, 100.0 * share / count, 95.0, "%", f"{count} robots")
            else:
                yield Row.context(name, 100.0 * share / count, "%", f"{count} robots")


def _worst_pose(seeds: Sequence[int], sessions: int) -> Iterator[Row]:
    """Yield how often a session passes, or fails, whose worst pose is at the limit and whose others are far below it,
    of the same kind or Gaussian; and how often one of equal Gaussian poses passes.

    Sessions are assessed whole, with the process that their cycles follow.
    """
    size = np.array([1.0, *[0.2] * (POSES - 1)])[:, None]
    for name, process, alone in (
        ("Gauss", gaussian, False),
        ("Student t4", student, False),
        ("AR .8", correlated, False),
        ("Student t4, the others Gauss", student, True),
        ("AR .8, the others Gauss", correlated, True),
    ):
        limit = _single_pose_rp(student if process is student else gaussian)
        for n in (12, 30):
            found = {"pass": 0, "fail": 0}
            for seed in seeds:
                for k in range(sessions):
                    rng = np.random.default_rng([seed, n, k, 17])
                    x = size * process(rng, n)
                    if alone:
                        x[:, 1:] = size[1:] * gaussian(rng, n)[:, 1:]
                    decision = _decision(x, limit)
                    if decision in found:
                        found[decision] += 1
            count = len(seeds) * sessions
            for what, times in found.items():
                note = f"{count} sessions of one pose at the limit and four at a fifth of it"
                yield Row.at_most(
                    f"worst pose at the limit: {what}, {name}, n {n}", 100.0 * times / count, 4.0, "%", note
                )
    limit = _single_pose_rp(gaussian)
    for share in (0.5, 0.6):
        for n in (12, 30):
            passed = [
                _decision(share * gaussian(np.random.default_rng([seed, n, k, 18]), n), limit) == "pass"
                for seed in seeds
                for k in range(sessions)
            ]
            yield Row.context(
                f"RP_l of {share:g} of the limit, whole sessions: passes, n {n}",
                100.0 * float(np.mean(passed)),
                "%",
                f"{len(passed)} sessions of five equal Gaussian poses",
            )


def _single_pose_rp(process: Process) -> float:
    """Return the long-run RP_l of a process, mm."""
    lengths = np.linalg.norm(process(np.random.default_rng(5), 200_000), axis=2)
    return float(lengths.mean() + 3.0 * lengths.std())


def _decision(x: Float[np.ndarray, "n p 3"], limit_mm: float) -> str:
    data = dataclasses.replace(measured_session(x), datasheet=Datasheet(repeatability_mm=limit_mm))
    decided = assess_acceptance(data, assess_session(data)).repeatability
    assert decided is not None
    return str(decided.found.decision)
