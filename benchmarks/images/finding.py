"""Images that do not show the requested board: false accepts, boards identified as another one, and time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from statistics import median

import cv2
import numpy as np

from benchmarks.conditions import BOARDS, one_core, seconds, standard_scenes, without_board
from benchmarks.table import Row
from core import TargetSpec
from core.errors import DetectionError, TargetMismatch
from core.simulation import Scene, render
from core.targets import detect

OTHERS = ((1, 0), (-1, 0), (0, 1), (0, -1), (-2, -1), (2, 1))  # columns, rows more than the board in view has


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    per_seed = 1 if quick else 12
    scenes = list(standard_scenes(seeds, BOARDS, per_seed))
    accepted: list[str] = []
    asked = identified = 0
    for kind, image, target in _images(scenes):
        asked += 1
        try:
            detect(image, target)
        except TargetMismatch:
            identified += 1
        except DetectionError:
            pass
        else:
            accepted.append(kind)
    note = f"{asked} images: no board, another board, a cropped one, two copies"
    if accepted:
        note += "; accepted: " + ", ".join(sorted(set(accepted)))
    yield Row.at_most("false accepts", float(len(accepted)), 0.0, note=note)
    yield Row.context("identified as another grid", float(identified), note=note)
    yield from _time(seeds, 2 if quick else 12)


def _images(scenes: list[Scene]) -> Iterator[tuple[str, np.ndarray, TargetSpec]]:
    for number, scene in enumerate(scenes):
        target, image = scene.target, render(scene)
        yield "no board", without_board(scene), target
        for columns, more_rows in OTHERS:
            other = dataclasses.replace(
                target, columns=target.columns + columns, rows=target.rows + more_rows
            )
            yield "another board", image, other
        yield "cropped", _cropped(scene, image, number), target
        yield "two copies", _twice(scene, image), target


def _cropped(scene: Scene, image: np.ndarray, number: int) -> np.ndarray:
    """Return the image cropped so that it lacks some or all of one side's grid points."""
    grid = scene.points_px.reshape(scene.target.rows, scene.target.columns, 2)
    side = (grid[0], grid[-1], grid[:, 0], grid[:, -1])[number % 4]
    outward = side.mean(axis=0) - grid.mean(axis=(0, 1))
    axis = int(np.argmax(np.abs(outward)))
    cut = float(np.median(side[:, axis]))
    if outward[axis] > 0:
        keep = slice(0, int(cut))
    else:
        keep = slice(int(cut) + 1, image.shape[1 - axis])
    return np.ascontiguousarray(image[:, keep] if axis == 0 else image[keep])


def _twice(scene: Scene, image: np.ndarray) -> np.ndarray:
    """Return two copies of the image side by side, each at half the size."""
    half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return np.asarray(np.hstack([half, half]))


def _time(seeds: list[int], per_seed: int) -> Iterable[Row]:
    """Time to find no board, compared with decoding the same image and with OpenCV's search."""
    ours: list[float] = []
    decoding: list[float] = []
    theirs: list[float] = []
    with one_core():
        for index, scene in enumerate(standard_scenes(seeds, [(9, 6)], per_seed)):
            image = without_board(scene)
            data = cv2.imencode(".png", image)[1]
            if index == 0:
                _refuse(image, scene.target)
            for _ in range(5):
                ours.append(seconds(lambda p=image, s=scene: _refuse(p, s.target)))
                decoding.append(seconds(lambda d=data: cv2.imdecode(d, cv2.IMREAD_GRAYSCALE)))
            if index % per_seed == 0:
                theirs.append(seconds(lambda p=image: cv2.findChessboardCorners(p, (9, 6))))
    note = f"{len(seeds) * per_seed} images of clutter × 5, in turns, one core"
    yield Row.context("no grid here", 1e3 * median(ours), "ms", note + ", median")
    yield Row.at_most(
        "no grid here ÷ cv2.imdecode of the PNG", median(ours) / median(decoding), 0.3, note=note
    )
    yield Row.context("the same, slowest of all", max(ours) / median(decoding), note=note)
    yield Row.at_least(
        "findChessboardCorners ÷ ours, on clutter",
        float(np.mean(theirs)) / median(ours),
        500.0,
        note=f"{len(theirs)} images, mean",
    )


def _refuse(image: np.ndarray, target: TargetSpec) -> None:
    try:
        detect(image, target)
    except DetectionError:
        return
    raise AssertionError("There is no board in this image.")
