"""Sessions of a motionless robot from rendered images: the repeatability that camera noise alone produces.

A pose is rendered once without noise. Each of its images adds noise of its own to that rendering and is rounded to
8 bit: the same as rendering it anew, since the robot stands still. Poses are rendered in parallel processes.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np

from benchmarks.table import Row
from core.calibration import estimate_group
from core.comparison import (
    aruco_marker,
    central_marker,
    compare_methods,
    compare_repeatability,
)
from core.errors import GridposeError
from core.geometry import compose, invert, transform
from core.metrology import PoseCycles, assess_repeatability, position_repeatability
from core.simulation import Scene, render_levels
from core.targets import GridPoints, TargetSpec, charuco_layout, detect
from tests.support.simulation.scenes import standard_scene, standard_target
from tests.support.simulation.simulated_views import draw_pose
from tests.support.targets.board_markers import detect_markers

POSES, CYCLES = 5, 30
TILT = math.radians(30.0)
CHESSBOARD = standard_target(14, 10)
CHARUCO = TargetSpec("charuco", 14, 10, CHESSBOARD.pitch_mm, 0.75 * CHESSBOARD.pitch_mm, "DICT_5X5_100")
LARGE = TargetSpec("charuco", 4, 3, 60.0, 45.0, "DICT_5X5_100")
"""A board as large with few squares, of which one marker is a fifth of the width."""
PLACES = {
    "session": "board 40-75 % of the width",
    "standard": "board 45-90 % of what fits, off centre",
}
"""Where the board lies: as in a session of METHOD's own study, and as in the standard scenes of the corners."""


@dataclass(frozen=True)
class Shots:
    """One pose's images: which, and the grid points found in each."""

    seed: int
    pose: int
    views: list[GridPoints]
    missed: int
    squared_px: float
    """Mean square of the corners' errors, distances."""


def floors(seeds: list[int], quick: bool) -> Iterable[Row]:
    """Yield the floors of pooled and per-image estimates and of one marker, with their goals."""
    cycles = 6 if quick else CYCLES
    chosen = seeds[:1] if quick else seeds
    for place, words in PLACES.items():
        shots = _shots(place, CHESSBOARD, chosen, cycles)
        yield from _floors(shots, words)
    yield from _against_one_marker(_shots("session", CHARUCO, chosen, cycles))


def scene_of(place: str, target: TargetSpec, seed: int, pose: int) -> Scene:
    """Return one pose of a session: a standard scene, the board where `PLACES` has it, 30° tilted."""
    drawn = int(np.random.SeedSequence([seed, pose, 9283]).generate_state(1)[0])
    scene = standard_scene(target, drawn, tilt=TILT)
    if place == "standard":
        return scene
    rng = np.random.default_rng([seed, pose, 1])
    return replace(scene, T_camera_target=draw_pose(rng, target, scene.camera, scene.width_px, TILT))


def take(place: str, target: TargetSpec, seed: int, pose: int, cycles: int) -> Shots:
    """Render one pose and find the target in each of its images."""
    cv2.setNumThreads(1)
    scene = scene_of(place, target, seed, pose)
    levels = render_levels(scene)
    views: list[GridPoints] = []
    squares: list[float] = []
    for cycle in range(cycles):
        try:
            found = detect(noisy(levels, scene.noise_levels, seed, pose, cycle), target)
        except GridposeError:
            continue
        truth = scene.points_px[found.row * target.columns + found.column]
        squares.append(float(np.mean(np.sum((found.points_px - truth) ** 2, axis=1))))
        views.append(found)
    return Shots(seed, pose, views, cycles - len(views), float(np.mean(squares)) if squares else math.nan)


def noisy(levels: np.ndarray, noise_levels: float, *seed: int) -> np.ndarray:
    """Return an 8-bit image with white noise of its own."""
    drawn = np.random.default_rng([*seed, 2]).standard_normal(levels.shape, dtype=np.float32)
    return np.clip(np.rint(levels + np.float32(noise_levels) * drawn), 0, 255).astype(np.uint8)


def side_by_side() -> ProcessPoolExecutor:
    """Return processes for all cores, started afresh."""
    return ProcessPoolExecutor(os.cpu_count(), mp_context=multiprocessing.get_context("spawn"))


def _shots(place: str, target: TargetSpec, seeds: list[int], cycles: int) -> dict[int, list[Shots]]:
    with side_by_side() as pool:
        jobs = [
            pool.submit(take, place, target, seed, pose, cycles) for seed in seeds for pose in range(POSES)
        ]
        found: dict[int, list[Shots]] = {}
        for job in jobs:
            shots = job.result()
            found.setdefault(shots.seed, []).append(shots)
    return found


def _floors(shots: dict[int, list[Shots]], words: str) -> Iterable[Row]:
    images = sum(len(one.views) for of_seed in shots.values() for one in of_seed)
    missed = sum(one.missed for of_seed in shots.values() for one in of_seed)
    found = [one.squared_px for of_seed in shots.values() for one in of_seed if one.views]
    corner = math.sqrt(float(np.mean(found)))
    note = f"{len(shots)} sessions × {POSES} poses, {images} images ({missed} missed), corner rms {corner:.4f} px"
    for estimator, goal_mm in (("pooled", 0.010), ("per_image_fixed_pp", 0.030)):
        position, turn, ratio = _readings(shots, estimator)
        worst = f"worst pose {position.max():.4f} mm; {note}"
        what = f"RP_l floor, {estimator}, {words}"
        yield Row.at_most(what, float(position.mean()), goal_mm, "mm", worst)
        if estimator == "pooled":
            what = f"3 S floor of the worst angle, {estimator}, {words}"
            yield Row.at_most(what, float(turn.mean()), 0.0012, "deg", f"worst pose {turn.max():.5f} deg")
        what = f"floor read ÷ floor stated, {estimator}, {words}"
        yield Row.context(
            what, float(ratio.mean()), "", f"mean over poses; from {ratio.min():.2f} to {ratio.max():.2f}"
        )


def _readings(shots: dict[int, list[Shots]], estimator: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return RP_l (mm), the worst angle's 3 S (deg) and RP_l over its stated floor, of every pose."""
    position, turn, ratio = [], [], []
    for of_seed in shots.values():
        views = [view for one in of_seed for view in one.views]
        labels = np.array([one.pose for one in of_seed for _ in one.views])
        found = estimate_group(views, estimator, repeats=labels.tolist())
        pose_of = labels[found.images]
        cycles = [
            PoseCycles(
                found.positions_mm[pose_of == p], found.rotations[pose_of == p], found.scatter[pose_of == p]
            )
            for p in np.unique(pose_of)
        ]
        for figures in assess_repeatability(cycles):
            read, floor = figures.repeatability, figures.noise_floor
            if read.position_mm is None or not floor.position_mm:
                continue
            position.append(read.position_mm)
            turn.append(math.degrees(max(read.roll or 0.0, read.pitch or 0.0, read.yaw or 0.0)))
            ratio.append(read.position_mm / floor.position_mm)
    return np.array(position), np.array(turn), np.array(ratio)


def _against_one_marker(shots: dict[int, list[Shots]]) -> Iterable[Row]:
    """Compare on the same ChArUco images, cameras calibrated from them: one marker, the board by OpenCV, and ours."""
    methods = ("aruco_marker", "aruco_board", "pooled")
    read: dict[str, list[float]] = {method: [] for method in methods}
    for of_seed in shots.values():
        views = [view for one in of_seed for view in one.views]
        labels = [one.pose for one in of_seed for _ in one.views]
        table = compare_repeatability(
            compare_methods(views, estimate_group(views, "pooled", repeats=labels), methods=methods), labels
        )
        for row in table:
            read[row.method] += [
                p.repeatability.position_mm if p.repeatability.position_mm is not None else math.nan
                for p in row.poses
            ]
    mean = {method: float(np.nanmean(values)) if values else math.nan for method, values in read.items()}
    images = sum(len(one.views) for of_seed in shots.values() for one in of_seed)
    missed = sum(one.missed for of_seed in shots.values() for one in of_seed)
    note = (
        f"{images} images ({missed} missed) of a ChArUco board 14x10, marker {CHARUCO.marker_mm:.3g} mm of a "
        f"{CHARUCO.pitch_mm:g} mm square; ours {mean['pooled']:.4f} mm"
    )
    yield Row.at_least(
        "one ArUco marker's RP_l ÷ ours, same images", mean["aruco_marker"] / mean["pooled"], 20, "", note
    )
    yield Row.context(
        "all markers' corners by OpenCV ÷ ours, same images",
        mean["aruco_board"] / mean["pooled"],
        "",
        "detectMarkers with cornerSubPix, solvePnP, our camera",
    )
    cycles = max(len(one.views) for of_seed in shots.values() for one in of_seed)
    with side_by_side() as pool:
        jobs = [
            pool.submit(read_large_marker, one.seed, one.pose, cycles) for of in shots.values() for one in of
        ]
        large = np.array([job.result() for job in jobs])
    yield Row.context(
        f"one marker of {LARGE.marker_mm:.3g} mm ÷ ours, same poses and noise",
        float(np.nanmean(large)) / mean["pooled"],
        "",
        f"{int(np.isfinite(large).sum())} of {large.size} poses found; a board of {LARGE.columns + 1}x{LARGE.rows + 1} "
        "squares in the other's place, its true camera",
    )


def read_large_marker(seed: int, pose: int, cycles: int) -> float:
    """Return RP_l of the central marker of `LARGE`, standing where `CHARUCO` stands; NaN where it is not found."""
    cv2.setNumThreads(1)
    scene = scene_of("session", CHARUCO, seed, pose)
    apart = CHARUCO.points_target().mean(axis=0) - LARGE.points_target().mean(axis=0)
    scene = replace(
        scene, target=LARGE, T_camera_target=compose(scene.T_camera_target, transform(np.eye(3), apart))
    )
    layout = charuco_layout(LARGE)
    marker = central_marker(layout)
    levels = render_levels(scene)
    positions = []
    for cycle in range(cycles):
        found = detect_markers(noisy(levels, scene.noise_levels, seed, pose, cycle), LARGE)
        if marker in found:
            T = aruco_marker(found[marker], layout.marker_corners(marker), scene.camera).T_camera_target[0]
            positions.append(invert(T)[:3, 3])
    return position_repeatability(np.array(positions)) if len(positions) > 1 else math.nan
