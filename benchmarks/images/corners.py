"""Corners: boards found, and errors of their corners compared with the Cramér-Rao bound and with OpenCV.

A corner's rms is that of one coordinate, over u and v, as the noise in the fits is; so are the bounds and the stated
uncertainties. The worst corner and an image's mean error are distances.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np

from benchmarks.conditions import BOARDS, standard_scenes
from benchmarks.table import Row
from core.errors import DetectionError
from core.simulation import Scene, render
from core.targets import detect
from tests.support.cramer_rao import corner_bounds

RMS_GOALS_PX = {(9, 6): 0.008, (14, 10): 0.0095, (25, 18): 0.0125}
SUBPIX_GOALS = {(9, 6): 0.19, (14, 10): 0.22, (25, 18): 0.30}
SUBPIX_WINDOW = (11, 11)
SUBPIX_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
WRONG_PX = 1.0
WITH_BOUND = 8 * len(BOARDS)  # of so many scenes those of one round of boards


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    per_seed = 1 if quick else -(-300 // (len(seeds) * len(BOARDS)))
    scenes = list(standard_scenes(seeds, BOARDS, per_seed))
    # a bound takes five more renderings; some scenes of each board are enough
    bounded = [index % WITH_BOUND < len(BOARDS) for index in range(len(scenes))]
    with ProcessPoolExecutor(os.cpu_count() or 1, multiprocessing.get_context("spawn")) as pool:
        seen = list(pool.map(_look, scenes, bounded, chunksize=1))
    note = f"{len(seen)} random poses, tilts 0-60°, {len(seeds)} seeds, {len(BOARDS)} boards"
    wrong = sum(s is not None and s.is_wrong for s in seen)
    share = 100.0 * sum(s is not None and not s.is_wrong for s in seen) / len(seen)
    yield Row.at_least("boards found", share, 100.0, "%", note)
    yield Row.at_most("boards found at a wrong place", float(wrong), 0.0, note=note)
    found = [s for s in seen if s is not None and not s.is_wrong]
    for board in BOARDS:
        yield from _accuracy(board, [s for s in found if s.board == board])
    note = f"{sum(len(s.errors_px) for s in found):,} corners"
    yield Row.at_most("worst corner", max(float(s.distance_px.max()) for s in found), 0.04, "px", note)
    bias = np.array([np.linalg.norm(s.errors_px.mean(axis=0)) for s in found])
    # the mean length of a two-dimensional normal vector is √(π/2) of one coordinate's standard deviation
    chance = np.array([_rms(s.stated_px) / np.sqrt(len(s.errors_px)) for s in found]) * np.sqrt(np.pi / 2.0)
    common = np.mean([s.errors_px.mean(axis=0) for s in found], axis=0)
    yield Row.at_most("bias common to all images", float(np.linalg.norm(common)), 0.001, "px", note)
    yield Row.at_most("mean error of an image, median", float(np.median(bias)), 0.001, "px", note)
    yield Row.context("the same, expected of noise alone", float(np.median(chance)), "px", note)
    rejected = sum(s.rejected for s in found)
    yield Row.context("corners rejected as unreliable", float(rejected), note=note)


def _accuracy(board: tuple[int, int], seen: list[_Seen]) -> Iterable[Row]:
    name = f"{board[0]}x{board[1]}"
    if not seen:
        yield Row.at_most(f"corner rms, {name}", float("nan"), RMS_GOALS_PX[board], "px")
        return
    distances, subpix, stated = (
        np.concatenate([getattr(s, field) for s in seen])
        for field in ("distance_px", "subpix_distance_px", "stated_px")
    )
    rms, theirs = _rms(distances) / np.sqrt(2.0), _rms(subpix) / np.sqrt(2.0)
    note = f"{len(seen)} images, {len(distances):,} corners, blur 1 px, noise 4 levels"
    yield Row.at_most(f"corner rms, {name}", rms, RMS_GOALS_PX[board], "px", note)
    some = [s for s in seen if s.bounds_px is not None]
    bound = _rms(np.concatenate([s.bounds_px for s in some if s.bounds_px is not None]))
    here, there = (
        _rms(np.concatenate([getattr(s, field) for s in some])) / np.sqrt(2.0)
        for field in ("distance_px", "subpix_distance_px")
    )
    on = (
        f"the bound of each corner's own half cells, {len(some)} images; 2-D rms {here * np.sqrt(2.0):.4f} px"
    )
    yield Row.at_most(f"corner rms ÷ Cramér-Rao bound, {name}", here / bound, 1.2, note=on)
    compared = f"the same corners; the bound itself ÷ cornerSubPix: {bound / there:.3f}"
    yield Row.at_most(
        f"corner rms ÷ cornerSubPix 11, {name}", rms / theirs, SUBPIX_GOALS[board], note=compared
    )
    z = _rms(distances / stated) / np.sqrt(2.0)
    yield Row.within(f"error ÷ stated uncertainty, rms, {name}", z, 0.95, 1.05, note=note)


@dataclass(frozen=True)
class _Seen:
    """One image's corners against the truth."""

    board: tuple[int, int]
    errors_px: np.ndarray
    bounds_px: np.ndarray | None
    subpix_distance_px: np.ndarray
    stated_px: np.ndarray
    rejected: int

    @property
    def distance_px(self) -> np.ndarray:
        return np.asarray(np.linalg.norm(self.errors_px, axis=1))

    @property
    def is_wrong(self) -> bool:
        return bool(np.any(self.distance_px > WRONG_PX))


def _look(scene: Scene, with_bound: bool) -> _Seen | None:
    """Detect a rendered board and compare; None where it is not found."""
    cv2.setNumThreads(1)
    image = render(scene)
    try:
        found = detect(image, scene.target)
    except DetectionError:
        return None
    rows, columns = scene.target.rows, scene.target.columns
    index = found.row * columns + found.column
    truth = scene.points_px
    if (columns + rows) % 2 == 0 and np.linalg.norm(found.points_px - truth[index], axis=1).mean() > WRONG_PX:
        index = rows * columns - 1 - index  # such a board looks the same when turned
    start = found.points_px.astype(np.float32).reshape(-1, 1, 2)
    theirs = cv2.cornerSubPix(image, start, SUBPIX_WINDOW, (-1, -1), SUBPIX_STOP).reshape(-1, 2)
    return _Seen(
        board=(columns, rows),
        errors_px=found.points_px - truth[index],
        bounds_px=corner_bounds(scene).standard_deviation_px[index] if with_bound else None,
        subpix_distance_px=np.linalg.norm(theirs - truth[index], axis=1),
        stated_px=found.standard_uncertainty_px,
        rejected=scene.target.size - len(found),
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
