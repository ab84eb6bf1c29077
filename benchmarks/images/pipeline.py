"""Time from bytes to calibrated pose, compared with decoding alone and with the usual OpenCV recipes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from statistics import median

import cv2
import numpy as np

from benchmarks.conditions import BOARDS, one_core, seconds, standard_scenes
from benchmarks.table import Row
from core import GridPoints, TargetSpec, calibrate_image, calibrate_points
from core.errors import FocalNotObservable
from core.image import decode
from core.simulation import render
from core.targets import detect

NAIVE_STOP = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
SB = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


@dataclass
class _Times:
    """Seconds of one image by recipe, best of the repeats for each."""

    board: tuple[int, int]
    of: dict[str, list[float]] = field(default_factory=dict)

    def best(self, recipe: str) -> float:
        return min(self.of[recipe])


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    repeats, per_seed, sb_images = (2, 1, 1) if quick else (5, 12, 2)
    times: list[_Times] = []
    refused = 0
    with one_core():
        for index, scene in enumerate(standard_scenes(seeds, BOARDS, per_seed)):
            image = render(scene)
            png = cv2.imencode(".png", image)[1]
            jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
            png_file, jpeg_file = png.tobytes(), jpeg.tobytes()
            target = scene.target
            recipes = {
                "PNG decoding": lambda d=png: cv2.imdecode(d, cv2.IMREAD_GRAYSCALE),
                "PNG": lambda d=png_file, t=target: _calibrate(d, t),
                "JPEG decoding": lambda d=jpeg: cv2.imdecode(d, cv2.IMREAD_GRAYSCALE),
                "JPEG": lambda d=jpeg_file, t=target: _calibrate(d, t),
                "decode": lambda d=png_file: decode(d),
                "detect": lambda p=image, t=target: detect(p, t),
            }
            if index == 0:
                for recipe in recipes.values():
                    recipe()  # code and caches warm
            taken = _Times((target.columns, target.rows))
            refused += not _calibrate(png_file, target)
            for _ in range(repeats):
                _measure(taken, recipes)
            _measure(taken, {"naive": lambda d=png, t=target: _naive(d, t)})
            if index < sb_images * len(BOARDS):
                _measure(taken, {"SB": lambda d=png, t=target: _sector_based(d, t)})
            points = detect(image, target)
            for _ in range(repeats):
                _measure(taken, {"fit": lambda p=points: _fit(p)})
            times.append(taken)
    yield from _report(times, repeats, refused)


def _report(times: list[_Times], repeats: int, refused: int) -> Iterable[Row]:
    note = (
        f"{len(times)} images of 5 Mpx, best of {repeats} each, in turns, one core; {refused} refused as flat"
    )
    for board in BOARDS:
        mine = [t for t in times if t.board == board]
        name = f"{board[0]}x{board[1]}"
        stages = ", ".join(
            f"{stage} {1e3 * median(t.best(stage) for t in mine):.1f}"
            for stage in ("decode", "detect", "fit")
        )
        ms = 1e3 * median(t.best("PNG") for t in mine)
        yield Row.context(f"PNG bytes to pose, {name}", ms, "ms", f"{stages} ms")
        for kind, goal in (("PNG", 0.8), ("JPEG", 1.4)):
            ratio = median(t.best(kind) / t.best(f"{kind} decoding") for t in mine)
            what = f"{kind} bytes to pose ÷ cv2.imdecode alone, {name}"
            if board == (14, 10):
                yield Row.at_most(what, ratio, goal, note=note)
            else:
                yield Row.context(what, ratio, note=note)
    ratios = [t.best("naive") / t.best("PNG") for t in times]
    recipe = "findChessboardCorners, cornerSubPix 11, calibrateCamera"
    yield Row.at_least("naive recipe ÷ ours, mean", float(np.mean(ratios)), 4.0, note=recipe)
    yield Row.at_least("naive recipe ÷ ours, worst image", max(ratios), 15.0, note=recipe)
    both = [t for t in times if "SB" in t.of]
    ratio = float(np.mean([t.best("SB") / t.best("PNG") for t in both]))
    recipe = f"findChessboardCornersSB EXHAUSTIVE ACCURACY, calibrateCamera; {len(both)} images"
    yield Row.at_least("SB recipe ÷ ours", ratio, 100.0, note=recipe)


def _measure(taken: _Times, recipes: dict[str, Callable[[], object]]) -> None:
    for name, recipe in recipes.items():
        taken.of.setdefault(name, []).append(seconds(recipe))


def _calibrate(data: bytes, target: TargetSpec) -> bool:
    try:
        calibrate_image(data, target)
    except FocalNotObservable:
        return False  # a flat view is refused at the very end: all of the work was done
    return True


def _fit(points: GridPoints) -> None:
    with suppress(FocalNotObservable):
        calibrate_points(points)


def _naive(data: np.ndarray, target: TargetSpec) -> None:
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    found, corners = cv2.findChessboardCorners(image, (target.columns, target.rows))
    if found:
        refined = cv2.cornerSubPix(
            image, corners.reshape(-1, 1, 2).astype(np.float32), (11, 11), (-1, -1), NAIVE_STOP
        )
        _opencv_fit(refined, target, image.shape)


def _sector_based(data: np.ndarray, target: TargetSpec) -> None:
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    found, corners = cv2.findChessboardCornersSB(image, (target.columns, target.rows), flags=SB)
    if found:
        _opencv_fit(corners, target, image.shape)


def _opencv_fit(corners: np.ndarray, target: TargetSpec, shape: tuple[int, ...]) -> None:
    cv2.calibrateCamera(
        [target.points_target().astype(np.float32)],
        [np.asarray(corners, dtype=np.float32).reshape(-1, 2)],
        (shape[1], shape[0]),
        None,
        None,
    )
