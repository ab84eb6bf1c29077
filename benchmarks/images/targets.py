"""Every kind of target: corners and centres against rendered truth, wrong labels, and time over the chessboard's."""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import astuple, dataclass, replace
from functools import partial
from itertools import islice
from statistics import median

import cv2
import numpy as np

from benchmarks.conditions import one_core, seconds
from benchmarks.table import Row
from core import TargetSpec, calibrate_image
from core.errors import DetectionError, FocalNotObservable
from core.geometry import Camera
from core.simulation import Scene, random_pose, render
from core.targets import charuco_layout, detect, find_by_lattice, marker_codes
from tests.support.image.mutated_views import mutated_views
from tests.support.simulation.scenes import standard_camera, standard_scene, standard_target

CHARUCO = (
    TargetSpec("charuco", 9, 6, 33.0, 24.0, "DICT_5X5_100"),
    TargetSpec("charuco", 14, 10, 21.4, 16.0, "DICT_5X5_100"),
)
APRILGRID = TargetSpec("aprilgrid", 6, 6, 45.5, 35.0)
CIRCLES = (TargetSpec("circles", 14, 10, 21.4), TargetSpec("asymmetric_circles", 7, 20, 15.0))
CHESSBOARD = standard_target(14, 10)
DOT_TILT, DOT_K1 = math.radians(45.0), -0.2
SUBPIX_WINDOW = (5, 5)  # half the gap between tags, where they are smallest
SUBPIX_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
WRONG_PX, MUTATED_VIEWS, _CHUNK = 1.0, 10_000, 50  # views of one seed
ASTRAY_PX = {"circles": 0.5, "asymmetric_circles": 0.5, "charuco": 1.0, "aprilgrid": 1.0}  # drawn to .3 px
MUTATED_KINDS = ("charuco", "aprilgrid", "circles", "asymmetric_circles")  # share the views equally
WRONG_NAMES = "points accepted under a wrong name"


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    """Yield accuracy, names and times of the targets that are no chessboards."""
    per_seed = 1 if quick else 12
    with ProcessPoolExecutor(os.cpu_count() or 1, multiprocessing.get_context("spawn")) as pool:
        jobs = [
            (target, int(np.random.SeedSequence([seed, index, target.size]).generate_state(1)[0]))
            for target in (*CHARUCO, APRILGRID)
            for seed in seeds
            for index in range(per_seed)
        ]
        corners = list(pool.map(_corners, *zip(*jobs, strict=True)))
        yield from _charuco([c for c in corners if c.target.kind == "charuco"])
        yield from _aprilgrid([c for c in corners if c.target.kind == "aprilgrid"])
        for target in CIRCLES:
            drawn = [1000 * seed + index for seed in seeds for index in range(per_seed)]
            yield from _dots(target, list(pool.map(_dot_errors, [target] * len(drawn), drawn)))
        yield from _names(pool, seeds, 200 if quick else MUTATED_VIEWS)
    yield from _time(seeds, 1 if quick else 4, 2 if quick else 5)


@dataclass(frozen=True)
class _Corners:
    """Errors (px) of one image's corners, u and v; None if the board was not found.

    `both_px` and `theirs_px` are ours and OpenCV's at the corners that both found.
    """

    target: TargetSpec
    ours_px: np.ndarray | None
    stated_px: np.ndarray | None
    both_px: np.ndarray
    theirs_px: np.ndarray
    theirs_missing: int


def _corners(target: TargetSpec, seed: int) -> _Corners:
    """Detect a rendered board and compare with OpenCV: its ChArUco detector, or cornerSubPix from our corners."""
    cv2.setNumThreads(1)
    scene = standard_scene(target, seed)
    image = render(scene)
    try:
        found = detect(image, target)
    except DetectionError:
        return _Corners(target, None, None, np.zeros((0, 2)), np.zeros((0, 2)), 0)
    index = found.row * target.grid_columns + found.column
    ours = np.full((target.size, 2), np.nan)
    ours[index] = found.points_px - scene.points_px[index]
    theirs = np.full((target.size, 2), np.nan)
    if target.kind == "charuco":
        seen, numbers = _opencv_charuco(image, target)
        theirs[numbers] = seen - scene.points_px[numbers]
    else:
        start = found.points_px.astype(np.float32).reshape(-1, 1, 2)
        seen = cv2.cornerSubPix(image, start, SUBPIX_WINDOW, (-1, -1), SUBPIX_STOP).reshape(-1, 2)
        theirs[index] = seen - scene.points_px[index]
    with np.errstate(invalid="ignore"):
        both = np.isfinite(ours[:, 0]) & (np.abs(theirs).max(axis=1) < WRONG_PX)
    missing = int(np.sum(np.isfinite(ours[:, 0]))) - int(both.sum())
    return _Corners(target, ours[index], found.standard_uncertainty_px, ours[both], theirs[both], missing)


def _opencv_charuco(image: np.ndarray, target: TargetSpec) -> tuple[np.ndarray, np.ndarray]:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(target.dictionary)))
    size = (target.columns + 1, target.rows + 1)
    board = cv2.aruco.CharucoBoard(size, target.pitch_mm, float(target.marker_mm or 0.0), dictionary)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(image)
    if numbers is None:
        return np.zeros((0, 2)), np.zeros(0, np.intp)
    return corners.reshape(-1, 2).astype(np.float64), numbers.ravel().astype(np.intp)


def _charuco(seen: list[_Corners]) -> Iterable[Row]:
    for target in CHARUCO:
        of_target = [c for c in seen if c.target == target]
        name, note = f"ChArUco {target.columns}x{target.rows}", _found_note(of_target)
        ours, theirs = (
            _rms(np.concatenate([getattr(c, f) for c in of_target])) for f in ("both_px", "theirs_px")
        )
        missing = sum(c.theirs_missing for c in of_target)
        on = f"{note}; OpenCV {theirs:.4f} px on the same corners; {missing} more it misses or has 1 px off"
        yield Row.at_most(f"{name} corner rms ÷ OpenCV's CharucoDetector", ours / theirs, 0.2, note=on)
        yield from _accuracy(name, of_target)


def _aprilgrid(seen: list[_Corners]) -> Iterable[Row]:
    name = f"AprilGrid {APRILGRID.columns}x{APRILGRID.rows}"
    ours, theirs = (_rms(np.concatenate([getattr(c, f) for c in seen])) for f in ("both_px", "theirs_px"))
    on = f"{_found_note(seen)}; cornerSubPix 5 from our corners: {theirs:.4f} px"
    yield Row.context(f"{name} corner rms ÷ cornerSubPix", ours / theirs, note=on)
    yield from _accuracy(name, seen)


def _accuracy(name: str, seen: list[_Corners]) -> Iterable[Row]:
    measured = [c for c in seen if c.ours_px is not None and c.stated_px is not None]
    note = _found_note(seen)
    if not measured:
        yield Row.at_least(f"{name}: views found", 0.0, 100.0, "%", note)
        return
    yield Row.at_least(f"{name}: views found", 100.0 * len(measured) / len(seen), 100.0, "%", note)
    errors = np.concatenate([c.ours_px for c in measured if c.ours_px is not None])
    stated = np.concatenate([c.stated_px for c in measured if c.stated_px is not None])
    yield Row.context(f"{name} corner rms", _rms(errors), "px", note)
    what = f"{name}: error ÷ stated uncertainty, rms"
    yield Row.within(what, _rms(errors / stated[:, None]), 0.95, 1.05, note=note)


def _found_note(seen: list[_Corners]) -> str:
    corners = sum(len(c.ours_px) for c in seen if c.ours_px is not None)
    return f"{len(seen)} standard scenes, tilts 0-60°, {corners:,} corners"


def _dot_errors(target: TargetSpec, seed: int) -> np.ndarray | None:
    """Return the errors (px) of the dots of an image without noise; None if the board was not found."""
    cv2.setNumThreads(1)
    camera: Camera = replace(standard_camera(), k1=DOT_K1, k2=0.0)
    T = random_pose(target, camera, (2448, 2050), DOT_TILT, math.pi, np.random.default_rng([seed, 45]))
    scene = Scene(target, camera, T, bit_depth=16, seed=seed)
    try:
        found = detect(render(scene), target)
    except DetectionError:
        return None
    truth = scene.points_px
    index = found.row * target.columns + found.column
    if found.labelling == "up_to_symmetry" and np.abs(found.points_px - truth[index]).mean() > WRONG_PX:
        index = target.size - 1 - index
    return np.asarray(found.points_px - truth[index])


def _dots(target: TargetSpec, errors: list[np.ndarray | None]) -> Iterable[Row]:
    found = [e for e in errors if e is not None]
    name = f"{target.kind} {target.columns}x{target.rows}"
    note = f"{len(errors)} scenes at 45°, k1 -.2, no noise, {sum(len(e) for e in found):,} dots"
    yield Row.at_least(f"{name}: views found", 100.0 * len(found) / len(errors), 100.0, "%", note)
    every = np.concatenate([np.linalg.norm(e, axis=1) for e in found]) if found else np.array([math.nan])
    yield Row.at_most(f"{name}: bias of the worst centre", float(every.max()), 0.005, "px", note)
    yield Row.context(f"{name}: bias of the centres, rms", _rms(every), "px", note)


@dataclass(frozen=True)
class _LabelCounts:
    """What became of some mutated views: points with a wrong name, points accepted and those of them that are `astray`,
    views as stated and those of them measured; `by_markers` those of any that only OpenCV's marker detector finds."""

    views: int
    wrong: int
    corners: int
    astray: int
    as_stated: int
    measured: int
    by_markers: int


def _count_labels(kind: str, seed: int, count: int) -> _LabelCounts:
    cv2.setNumThreads(1)
    wrong = corners = astray = as_stated = measured = by_markers = 0
    for view in islice(mutated_views(seed, kind=kind), count):
        as_stated += view.is_as_stated
        try:
            found = detect(view.image, view.target)
        except DetectionError:
            continue
        wrong += view.wrong(found)
        corners += len(found)
        off = np.linalg.norm(found.points_px[:, None] - view.points_px, axis=2)
        astray += int(np.count_nonzero(np.nanmin(off, axis=1, initial=np.inf) > ASTRAY_PX[kind]))
        measured += view.is_as_stated
        if kind == "charuco":
            codes = marker_codes(str(view.target.dictionary))
            by_markers += find_by_lattice(view.image, charuco_layout(view.target), codes).part is None
    return _LabelCounts(count, wrong, corners, astray, as_stated, measured, by_markers)


def _names(pool: ProcessPoolExecutor, seeds: list[int], views: int) -> Iterable[Row]:
    """Count wrong names in views with things before the board, soiled, with other boards and mirrored ones: by kind,
    and all together."""
    each = views // len(MUTATED_KINDS)
    every = []
    for kind in MUTATED_KINDS:
        drawn = np.random.SeedSequence([*seeds, len(kind)]).generate_state(-(-each // _CHUNK))
        counts = [min(_CHUNK, each - _CHUNK * k) for k in range(len(drawn))]
        total = _together(pool.map(_count_labels, [kind] * len(drawn), [int(s) for s in drawn], counts))
        every.append(total)
        note = _views_note(total)
        yield Row.at_most(f"{kind}: {WRONG_NAMES}", float(total.wrong), 0.0, note=note)
        share = 100.0 * total.measured / max(total.as_stated, 1)
        yield Row.context(f"{kind}: mutated views measured", share, "%", note)
        yield Row.context(f"{kind}: points {ASTRAY_PX[kind]} px off and more", float(total.astray), note=note)
        if kind == "charuco":
            alone = 100.0 * total.by_markers / max(total.views, 1)
            yield Row.context(f"{kind}: found by OpenCV's markers alone", alone, "%", note)
    total = _together(every)
    what = f"every kind with markers or dots: {WRONG_NAMES}"
    yield Row.at_most(what, float(total.wrong), 0.0, note=_views_note(total))


def _together(seen: Iterable[_LabelCounts]) -> _LabelCounts:
    return _LabelCounts(*map(sum, zip(*map(astuple, seen), strict=True)))


def _views_note(seen: _LabelCounts) -> str:
    return (
        f"{seen.views:,} rendered and mutated views, {seen.corners:,} points accepted; of {seen.as_stated:,} views "
        f"that show the board asked for {seen.measured:,} were measured"
    )


def _time(seeds: list[int], per_seed: int, repeats: int) -> Iterable[Row]:
    """Time from bytes to pose, and of detection alone, over a chessboard's: images of equal size, as many points."""
    targets = {"chessboard": CHESSBOARD, "charuco": CHARUCO[1], "aprilgrid": APRILGRID}
    targets |= {target.kind: target for target in CIRCLES}
    paths: dict[str, list[float]] = {kind: [] for kind in targets}
    alone: dict[str, list[float]] = {kind: [] for kind in targets}
    with one_core():
        for index, seed in enumerate(s * per_seed + k for s in seeds for k in range(per_seed)):
            images = {kind: render(standard_scene(target, seed)) for kind, target in targets.items()}
            data = {kind: cv2.imencode(".png", image)[1].tobytes() for kind, image in images.items()}
            if index == 0:
                for kind, target in targets.items():
                    _calibrate(data[kind], target)  # code and caches warm
            for kind in targets:
                paths[kind].append(math.inf)
                alone[kind].append(math.inf)
            for _ in range(repeats):
                for kind, target in targets.items():
                    whole = seconds(partial(_calibrate, data[kind], target))
                    part = seconds(partial(_detect, images[kind], target))
                    paths[kind][-1] = min(paths[kind][-1], whole)
                    alone[kind][-1] = min(alone[kind][-1], part)
    note = f"{len(paths['chessboard'])} images of 5 Mpx each, 140-144 points, best of {repeats}, in turns, one core"
    for kind in targets:
        ms, path = 1e3 * median(alone[kind]), 1e3 * median(paths[kind])
        if kind == "chessboard":
            yield Row.context(
                "PNG bytes to pose, chessboard", path, "ms", f"detection alone {ms:.1f} ms; {note}"
            )
            continue
        ratio = median(a / b for a, b in zip(paths[kind], paths["chessboard"], strict=True))
        yield Row.at_most(
            f"PNG bytes to pose, {kind} ÷ chessboard", ratio, 2.0, note=f"{path:.1f} ms; {note}"
        )
        ratio = median(a / b for a, b in zip(alone[kind], alone["chessboard"], strict=True))
        yield Row.context(f"detection alone, {kind} ÷ chessboard", ratio, note=f"{ms:.1f} ms; {note}")


def _calibrate(data: bytes, target: TargetSpec) -> None:
    with suppress(FocalNotObservable, DetectionError):
        calibrate_image(data, target)


def _detect(image: np.ndarray, target: TargetSpec) -> None:
    with suppress(DetectionError):
        detect(image, target)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan
