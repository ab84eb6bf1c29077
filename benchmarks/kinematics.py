"""Identification of DH parameters: accuracy against known arms, coverage of what is stated, and speed.

A robot repeatability of .1 mm is ISO 9283's RP_l: of isotropic scatter with standard deviation σ along each axis,
RP_l = l̄ + 3 S_l = 3.616 σ, so σ is .0277 mm; the rotation about each axis scatters by .005°. What is not
identifiable (base and tool terms, d of parallel joints) is compared under one convention.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.conditions import seconds
from benchmarks.table import Row
from core.errors import DetectionError
from core.geometry import Camera, invert
from core.kinematics import (
    JOINT_PARAMETERS,
    Identification,
    PoseData,
    identify,
    identify_from_axes,
)
from core.simulation import (
    KR5_ARC,
    KR5_ARC_HOME,
    KR5_ARC_LIMITS,
    Arm,
    Light,
    Scene,
    free_angles,
    kr5_arc,
    render,
    sample_viewing_configurations,
    sweep_angles,
)
from core.targets import GridPoints, TargetSpec, detect
from tests.support.simulation.robots.arm_grid_points import image_poses, session
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

RP_L = 0.1
ROBOT = Repeatability(RP_L / 3.616, math.radians(0.005))
GRID = TargetSpec("chessboard", 14, 9, 25.0)
CAMERA = Camera(2350.0, 2348.0, 1230.0, 1018.0, -0.1, 0.05, 1e-4, -2e-4)
SIZE = (2448, 2050)
RENDERED = 60
BOWED = ((36, 0.05), (90, 0.05), (90, 0.2))
"""Images, and the bow of the print, mm."""


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    trials = 10 if quick else 40
    for free, limits in ((0, (0.045, 0.0055)), (30, (0.025, 0.003))):
        note = f"{trials * len(seeds)} arms as built; pooled poses, RP_l {RP_L:g} mm"
        extra = f" + {free} free poses" if free else ""
        figures = [
            _drawn(np.random.default_rng([s, k, free]), free, ROBOT) for s in seeds for k in range(trials)
        ]
        yield from _accuracy(f"DH rms, KR5 Arc, ±40°, 11 steps{extra}", figures, limits, note)
        yield _coverage(f"coverage of 95 % intervals of DH, ±40°, 11 steps{extra}", figures, note)
    note = f"{trials * len(seeds)} arms as built; pooled poses, perfect robot"
    still = [_drawn(np.random.default_rng([s, k]), 0, Repeatability()) for s in seeds for k in range(trials)]
    yield from _accuracy("DH rms, KR5 Arc, ±40°, 11 steps, perfect robot", still, None, note)
    yield _coverage("coverage of 95 % intervals of DH, perfect robot", still, note)
    yield from _rendered(seeds[:1] if quick else seeds, 24 if quick else RENDERED)
    for count, bow_mm, robot in ((36, 0.1, Repeatability()), *((n, b, ROBOT) for n, b in BOWED)):
        yield from _before_bow(seeds, 2 if quick else 8, count, bow_mm, robot)
    yield from _speed()


def _before_bow(
    seeds: list[int], trials: int, count: int, bow_mm: float, robot: Repeatability
) -> Iterator[Row]:
    """Arms whose camera looks at a bowed print, which leaves no residual that images do not share."""
    figures, of_flat = [], []
    for trial in (1000 * seed + k for seed in seeds for k in range(trials)):
        for bow, found in ((bow_mm, figures), (0.0, of_flat)):
            arm, q, views, _ = session(
                trial,
                count=count,
                bow_mm=bow,
                position_mm=robot.position_mm,
                rotation_rad=robot.rotation_rad,
            )
            found.append(_errors(arm, q, identify(image_poses(views, q), KR5_ARC, folds=0)))
    what = f"{count} images before a bow of {bow_mm:g} mm, {'robot scatters' if robot.position_mm else 'perfect robot'}"
    note = f"{len(figures)} arms, print of 350 mm, grid points to .02 px"
    ratio = np.array([e / u for e, u in figures])
    inside = np.abs(ratio[np.isfinite(ratio)]) < 1.96
    yield Row.at_least(f"{what}: DH within 95 % intervals", 100.0 * float(np.mean(inside)), 93.0, "%", note)
    lengths, as_flat = (
        math.sqrt(float(np.nanmean(np.array([e for e, _ in some])[:, :, [0, 2]] ** 2)))
        for some in (figures, of_flat)
    )
    yield Row.context(
        f"{what}: DH rms, lengths", lengths, "mm", f"{note}; before a flat print {as_flat:.4f} mm"
    )


def _drawn(rng: np.random.Generator, free: int, robot: Repeatability) -> tuple[np.ndarray, np.ndarray]:
    arm = kr5_arc(rng)
    q = np.vstack([sweep_angles(KR5_ARC_HOME), free_angles(rng, KR5_ARC_HOME, free)])
    return _errors(arm, q, identify(measure_poses(arm, q, rng, robot=robot), KR5_ARC, folds=0))


def _errors(arm: Arm, q: np.ndarray, found: Identification) -> tuple[np.ndarray, np.ndarray]:
    """Return errors and their stated uncertainties, a row per joint; NaN where not identifiable."""
    exact = measure_poses(arm, q, np.random.default_rng(0), estimator="exact")
    truth = identify(exact, KR5_ARC, folds=0).chain.as_array()
    stated = np.array(
        [[j.standard_uncertainty[name] or math.nan for name in JOINT_PARAMETERS] for j in found.joints]
    )
    return np.where(np.isfinite(stated), found.chain.as_array() - truth, np.nan), stated


def _accuracy(
    what: str,
    figures: list[tuple[np.ndarray, np.ndarray]],
    limits: tuple[float, float] | None,
    note: str,
) -> Iterator[Row]:
    errors = np.array([e for e, _ in figures])
    length = math.sqrt(float(np.nanmean(errors[:, :, [0, 2]] ** 2)))
    angle = math.degrees(math.sqrt(float(np.nanmean(errors[:, :, [1, 3, 4]] ** 2))))
    for value, unit, k in ((length, "mm", 0), (angle, "°", 1)):
        name = f"{what}, {'lengths' if k == 0 else 'angles'}"
        if limits is None:
            yield Row.context(name, value, unit, note)
        else:
            yield Row.at_most(name, value, limits[k], unit, note)


def _coverage(what: str, figures: list[tuple[np.ndarray, np.ndarray]], note: str) -> Row:
    ratio = np.array([e / u for e, u in figures])
    inside = np.abs(ratio[np.isfinite(ratio)]) < 1.96
    return Row.within(what, 100.0 * float(np.mean(inside)), 93.0, 97.0, "%", note)


def _rendered(seeds: list[int], count: int) -> Iterator[Row]:
    figures, took, found = [], [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        arm = kr5_arc(rng)
        q = sample_viewing_configurations(
            arm, GRID, CAMERA, SIZE, rng, count, home=KR5_ARC_HOME, limits=KR5_ARC_LIMITS
        )
        views = [_seen(T, seed, i) for i, T in enumerate(arm.camera_poses(q))]
        kept = np.array([i for i, v in enumerate(views) if v is not None])
        begun = time.perf_counter()
        result = identify(image_poses([v for v in views if v is not None], q[kept]), KR5_ARC, folds=0)
        took.append(time.perf_counter() - begun)
        figures.append(_errors(arm, q[kept], result))
        found.append(len(kept))
    note = (
        f"{len(seeds)} arms, {count} free poses that see the grid, of which it was found in {min(found)} at least; "
        f"{np.median(took):.2f} s for one identification"
    )
    yield from _accuracy("DH rms from rendered images, perfect robot", figures, (0.01, 0.001), note)
    ratio = np.array([e / u for e, u in figures])
    within = 100.0 * float(np.mean(np.abs(ratio[np.isfinite(ratio)]) < 1.96))
    yield Row.context("DH within 95 % intervals, from rendered images, perfect robot", within, "%", note)


def _seen(T_target_camera: np.ndarray, seed: int, index: int) -> GridPoints | None:
    scene = Scene(
        GRID,
        CAMERA,
        invert(T_target_camera),
        *SIZE,
        noise_levels=4.0,
        light=Light(gradient=(0.1, -0.08), vignetting=0.15),
        clutter=0.7,
        seed=1000 * seed + index,
        background_seed=1000 * seed + index,
    )
    try:
        return detect(render(scene), GRID)
    except DetectionError:
        return None


def _speed() -> Iterator[Row]:
    rng = np.random.default_rng(0)
    arm = kr5_arc(rng)
    q = free_angles(rng, KR5_ARC_HOME, 1500)
    poses = measure_poses(arm, q, rng, robot=ROBOT)
    bare = replace(poses, covariance=None, common=None)
    for name, given in (("with covariances and a common lens", poses), ("without covariances", bare)):
        yield _timed(name, given)
    homes = KR5_ARC_HOME + np.vstack([np.zeros(6), rng.uniform(-0.3, 0.3, (5, 6))])
    q = np.vstack([sweep_angles(home, steps=9) for home in homes])
    swept = measure_poses(arm, q, rng, robot=ROBOT)
    for method in ("cpa", "screw", "combined"):
        times = _times(partial(identify_from_axes, swept, KR5_ARC, method, folds=5))
        yield Row.context(
            f"identification of {len(swept)} poses from 36 sweeps, {method}",
            float(np.median(times[1:])),
            "s",
            "six sweeps of each joint; validation in five folds included",
        )


def _times(call: Callable[[], object]) -> list[float]:
    return [seconds(call) for _ in range(6)]


def _timed(name: str, poses: PoseData) -> Row:
    times = _times(partial(identify, poses, KR5_ARC))
    return Row.at_most(
        f"global identification of {len(poses):,} poses, {name}",
        float(np.median(times[1:])),
        1.0,
        "s",
        f"validation in five folds included; the first call of a process {times[0]:.2f} s",
    )
