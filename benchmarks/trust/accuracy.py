"""Pose accuracy (AP) and its drift (dAP): reported over true, and coverage, for simulated robots before an instrument.

A robot misses each commanded pose by a vector of its own; a tracker or camera with noise measures some cycles of it
in a frame that only the commanded poses tie. The truth is what the robot was off at each pose, as drawn, rigid part
included.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.table import Row
from core.geometry import rotation_to_rpy, so3_exp, transform
from core.session import CommandedPose, MeasuredPose, PoseRow, SessionData, accuracy_drift_of, drift_of
from core.session.commanded_poses import Accuracy, assess_accuracy

DEVIATION_MM, DEVIATION_RAD = 0.3, math.radians(0.03)
SCATTER_MM, SCATTER_RAD = 0.03, math.radians(0.005)
DRIFT_MM = 0.1
ROBOTS = 600
CUBE = np.array([[0, 0, 0], [1, 1, 1], [-1, -1, 1], [1, -1, -1], [-1, 1, -1]], dtype=np.float64)
"""Centre and diagonals of a cube's planes."""


@dataclass(frozen=True)
class Layout:
    """Commanded poses: how many and in which orientations; what the robot is off and scatters by; number of cycles."""

    name: str
    count: int
    orientations: str = "one"  # one, any, or unknown
    cycles: int = 10
    deviation_mm: float = DEVIATION_MM
    scatter_mm: float = SCATTER_MM


LAYOUTS = (
    Layout("five cube poses, one orientation", 5),
    Layout("five poses, any orientation", 5, "any"),
    Layout("six poses, any orientation", 6, "any"),
    Layout("ten poses, any orientation", 10, "any"),
    Layout("ten positions, orientation not commanded", 10, "unknown"),
    Layout("four cube poses, one orientation", 4),
)
DRIFTING = (
    Layout("five cube poses, one orientation", 5, cycles=20),
    Layout("six poses, any orientation", 6, "any", cycles=20),
    Layout("ten poses, any orientation", 10, "any", cycles=20),
)
RESTLESS = (
    Layout("five cube poses, three cycles, scatter ten times the deviation", 5, "one", 3, 0.01, 0.1),
    Layout("five cube poses, ten cycles, scatter ten times the deviation", 5, "one", 10, 0.01, 0.1),
    Layout("five cube poses, ten cycles, scatter three times the deviation", 5, "one", 10, 0.03, 0.1),
)
"""Where the mean pose scatters as much as the robot is off, or more, the length that is read is mostly noise."""


def simulate(rng: np.random.Generator, layout: Layout) -> tuple[Accuracy, np.ndarray, np.ndarray]:
    """Return the accuracy assessed, and what the robot was truly off: (n, 3) mm and (n, 3) rad, base frame."""
    data, visits, off, turned = simulate_visits(rng, layout)
    return assess_accuracy(data, visits), off, turned


def simulate_visits(
    rng: np.random.Generator, layout: Layout, drift_mm: float = 0.0
) -> tuple[SessionData, dict[str, list[MeasuredPose]], np.ndarray, np.ndarray]:
    """Return a session's data and its visits by pose, and what the robot was off as `simulate` does.

    With `drift_mm`, each pose is off by a further vector of this standard deviation along each axis in the later half
    of its cycles; what it was off is then (2, n, 3), of both halves.
    """
    n = layout.count
    places = 250.0 * CUBE[:n] if layout.orientations == "one" else rng.uniform(-250.0, 250.0, (n, 3))
    if layout.orientations == "one":
        turns = np.broadcast_to(rng.normal(0.0, 0.4, 3), (n, 3))
    else:
        turns = rng.normal(0.0, 0.4, (n, 3))
    base = transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 500.0, 3))
    mount = transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 80.0, 3))
    off, turned = rng.normal(0.0, layout.deviation_mm, (n, 3)), rng.normal(0.0, DEVIATION_RAD, (n, 3))
    moved = rng.normal(0.0, drift_mm, (n, 3)) if drift_mm else np.zeros((n, 3))
    if layout.orientations == "one":
        # What is measured is the point in the camera's centre: its own deviation is the truth, lever arm included.
        mount[:3, 3] = 0.0
    commanded, visits = {}, {}
    for i in range(n):
        R = so3_exp(turns[i])
        roll, pitch, yaw = np.degrees(rotation_to_rpy(R)).tolist()
        name = f"P{i + 1}"
        angles = (None, None, None) if layout.orientations == "unknown" else (roll, pitch, yaw)
        commanded[name] = CommandedPose(places[i].tolist(), *angles)
        of_pose = []
        for cycle in range(1, layout.cycles + 1):
            late = float(2 * cycle > layout.cycles)
            attained = transform(
                so3_exp(turned[i] + rng.normal(0.0, SCATTER_RAD, 3)) @ R,
                places[i] + off[i] + late * moved[i] + rng.normal(0.0, layout.scatter_mm, 3),
            )
            T = np.linalg.inv(base) @ attained @ mount
            noise = np.diag([0.01**2] * 3 + [math.radians(0.001) ** 2] * 3)
            of_pose.append(
                MeasuredPose(f"{name}-{cycle}", name, cycle, None, T[:3, 3], T[:3, :3], noise, noise)
            )
        visits[name] = of_pose
    data = SessionData((), (), commanded=commanded)
    return data, visits, np.array([off, off + moved]) if drift_mm else off, turned


@dataclass(frozen=True)
class Outcome:
    """Over all poses of all robots: reported rms over true rms, coverage of AP and of its axes, the share of poses
    without accuracy; of orientations the ratio where they were compared.
    """

    ratio: float
    held_out: float
    coverage: float
    axes: float
    rotation_ratio: float
    missing: float


def measure(layout: Layout, robots: int, seed: int) -> Outcome:
    """Return the outcome for so many simulated robots."""
    rng = np.random.default_rng(seed)
    reported, true, held, inside, axes, turns, turns_true = [], [], [], [], [], [], []
    missing = 0
    for _ in range(robots):
        found, off, turned = simulate(rng, layout)
        for i in range(layout.count):
            one = found.poses.get(f"P{i + 1}")
            length = float(np.linalg.norm(off[i]))
            if one is None:
                missing += 1
                continue
            interval = one.interval
            assert one.figures.position_mm is not None
            reported.append(one.figures.position_mm)
            true.append(length)
            if one.held_out.position_mm is not None:
                held.append((one.held_out.position_mm, length))
            if interval.position_mm is not None:
                inside.append(interval.position_mm[0] <= length <= interval.position_mm[1])
            for value, limits in zip(off[i], (interval.x_mm, interval.y_mm, interval.z_mm), strict=True):
                if limits is not None:
                    axes.append(limits[0] <= value <= limits[1])
            if one.rotation is not None:
                turns.append(float(np.linalg.norm(one.rotation)))
                turns_true.append(float(np.linalg.norm(turned[i])))
    ratio = [np.array(values) for values in (reported, true, turns, turns_true)]
    rms = [float(np.sqrt(np.mean(v**2))) if len(v) else math.nan for v in ratio]
    held_rms = np.sqrt(np.mean(np.square(held), axis=0)) if held else np.array([math.nan, 1.0])
    return Outcome(
        rms[0] / rms[1],
        float(held_rms[0] / held_rms[1]),
        float(np.mean(inside)),
        float(np.mean(axes)),
        rms[2] / rms[3],
        missing / (robots * layout.count),
    )


def trust_rows(seeds: Sequence[int], quick: bool) -> Iterator[Row]:
    """Yield for every layout the ratio of reported to true AP and the coverage of its interval."""
    robots = 60 if quick else max(ROBOTS // len(seeds), 1)
    for layout in LAYOUTS:
        found = [measure(layout, robots, seed) for seed in seeds]
        ratio, coverage, axes, held, missing, turn = (
            float(np.mean([getattr(f, name) for f in found]))
            for name in ("ratio", "coverage", "axes", "held_out", "missing", "rotation_ratio")
        )
        note = f"{robots * len(seeds)} robots; without AP {missing:.1%}; held out / true {held:.2f}"
        yield Row.within(f"AP: {layout.name}: reported ÷ true, rms", ratio, 0.95, 1.1, note=note)
        yield Row.within(f"AP: {layout.name}: coverage of AP_p", 100.0 * coverage, 92.0, 98.0, "%")
        yield Row.within(f"AP: {layout.name}: coverage by axis", 100.0 * axes, 92.0, 98.0, "%")
        if math.isfinite(turn):
            yield Row.within(f"AP: {layout.name}: orientation, reported ÷ true, rms", turn, 0.95, 1.1)
    for layout in RESTLESS:
        coverage = 100.0 * float(np.mean([measure(layout, robots, seed).coverage for seed in seeds]))
        note = f"{robots * len(seeds)} robots, off by {layout.deviation_mm} mm along each axis"
        yield Row.within(f"AP: {layout.name}: coverage of AP_p", coverage, 92.0, 98.0, "%", note)
    for layout in DRIFTING:
        ratios = np.concatenate([_drift_ratios(layout, robots, seed) for seed in seeds])
        note = f"{robots * len(seeds)} robots that drift by {DRIFT_MM} mm along each axis, 20 cycles"
        within = 100.0 * float(np.mean(np.abs(ratios) < 1.96))
        rms = float(np.sqrt(np.mean(np.square(ratios))))
        yield Row.at_least(f"dAP: {layout.name}: within 1.96 u", within, 92.0, "%", note)
        yield Row.within(f"dAP: {layout.name}: rms of error ÷ u", rms, 0.7, 1.1, "", note)


def _drift_ratios(layout: Layout, robots: int, seed: int) -> np.ndarray:
    """Return (dAP reported - true) / u of every pose of so many robots."""
    rng = np.random.default_rng([seed, 8])
    ratios = []
    for _ in range(robots):
        data, visits, off, _ = simulate_visits(rng, layout, DRIFT_MM)
        accuracy = assess_accuracy(data, visits).poses
        early, late = np.linalg.norm(off, axis=2)
        for i, (name, of_pose) in enumerate(visits.items()):
            row = PoseRow(name, tuple(of_pose), (), None)
            drifting = drift_of(row)
            assert drifting is not None
            found = accuracy_drift_of(row, accuracy[name], drifting[1])
            assert found is not None
            assert found.standard_uncertainty_mm is not None
            ratios.append((found.dap_mm - abs(late[i] - early[i])) / found.standard_uncertainty_mm)
    return np.array(ratios)
