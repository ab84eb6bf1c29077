"""Photographs that others took, each by itself, against the camera that the set's other photographs determine.

Held-out split: the reference of a photograph is the focal length of OpenCV's multi-view calibration of all *other*
photographs of its set, on the same grid points. Nothing of the fit was chosen on these sets: its priors are from
published calibrations of other cameras. The naive recipe is `cv2.calibrateCamera` on the one view, principal point
held at the centre, square pixels, no tangential distortion.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.table import Row
from core import calibrate_points
from core.errors import GridposeError
from core.image import decode
from core.targets import GridPoints, TargetSpec, detect

CHESS, SMALL = TargetSpec("chessboard", 9, 6, 25.0), TargetSpec("chessboard", 6, 4, 30.0)
SETS = {
    "OpenCV left": ("opencv_samples/left??.jpg", CHESS),
    "OpenCV right": ("opencv_samples/right??.jpg", CHESS),
    "Sony, chessboard": ("boofcv/Sony_DSC-HX5V_Chess/*.jpg", SMALL),
    "Sony, circles": ("boofcv/Sony_DSC-HX5V_CircleRegular/*.jpg", TargetSpec("circles", 10, 8, 25.0)),
    "Bumblebee left": ("boofcv/Bumblebee2_Chess/left??.jpg", SMALL),
    "Bumblebee right": ("boofcv/Bumblebee2_Chess/right??.jpg", SMALL),
    "robot, ChArUco": (
        "robot_cal_tools/charuco/images/*.png",
        TargetSpec("charuco", 4, 6, 36.195, 18.256, "DICT_6X6_250"),
    ),
    "robot, circles": ("robot_cal_tools/circles_10x10/images/*.png", TargetSpec("circles", 10, 10, 25.4)),
    "GoPro": ("gopro_wide/*.jpg", TargetSpec("chessboard", 8, 6, 25.0)),
}
LIMITS = (0.02, 0.05, 0.15)
NAIVE = (
    cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_ASPECT_RATIO
    | cv2.CALIB_FIX_K3
)


@dataclass(frozen=True)
class _Answer:
    """One photograph: errors of f relative to the reference, ours with its stated uncertainty; None if refused."""

    naive: float
    ours: float | None
    uncertainty: float | None


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    del seeds  # nothing here is drawn
    folder = Path(
        os.environ.get("GRIDPOSE_TEST_DATA", Path(__file__).parents[3] / "shared" / "data"),
    )
    if not folder.is_dir():
        yield Row("photographs", "not here", note="set GRIDPOSE_TEST_DATA to their folder")
        return
    everything: list[_Answer] = []
    for name in list(SETS)[:1] if quick else SETS:
        answers = _of_set(folder, name)
        everything += answers
        yield from _rows_of(name, answers)
    yield from _rows_of("all", everything)


def detected(folder: Path, name: str) -> list[GridPoints]:
    """Return the grid points of every photograph of a set."""
    pattern, target = SETS[name]
    return [detect(decode(path.read_bytes()), target) for path in sorted(folder.glob(pattern))]


def _of_set(folder: Path, name: str) -> list[_Answer]:
    views = detected(folder, name)
    answers = []
    for i, points in enumerate(views):
        reference = _focal([view for k, view in enumerate(views) if k != i], 0)
        naive = _focal([points], NAIVE) / reference - 1.0
        try:
            found = calibrate_points(points)
        except GridposeError:
            answers.append(_Answer(naive, None, None))
            continue
        focal = 0.5 * (found.camera.fx_px + found.camera.fy_px)
        answers.append(
            _Answer(naive, focal / reference - 1.0, found.observability.focal_relative_uncertainty)
        )
    return answers


def _rows_of(name: str, answers: list[_Answer]) -> Iterable[Row]:
    naive = np.abs([a.naive for a in answers])
    ours = np.array([a.ours for a in answers if a.ours is not None])
    u = np.array([a.uncertainty for a in answers if a.uncertainty is not None])
    same = np.abs([a.naive for a in answers if a.ours is not None])
    note = f"{len(answers)} photographs, {len(ours)} answered, {len(answers) - len(ours)} refused"
    shares = " / ".join(f"{100 * np.sum(u <= limit) / len(answers):.0f} %" for limit in LIMITS)
    yield Row(f"{name}: u(f)/f within 2 / 5 / 15 %", shares, note=note)
    if not len(ours):
        return
    note = f"naive: {100 * np.median(naive):.3g} % of all; the goal is its median of those answered"
    yield Row.at_most(
        f"{name}: median relative error of f",
        100 * float(np.median(np.abs(ours))),
        100 * float(np.median(same)),
        "%",
        note,
    )
    note = f"largest {np.max(np.abs(ours / u)):.3g}; median u {100 * np.median(u):.3g} %"
    yield Row.within(f"{name}: rms of Δf/u(f)", float(np.sqrt(np.mean((ours / u) ** 2))), 0.7, 1.3, note=note)


def _focal(views: list[GridPoints], flags: int) -> float:
    """Return the mean of fx and fy by OpenCV."""
    size = views[0].image_width_px, views[0].image_height_px
    _, matrix, *_ = cv2.calibrateCamera(
        [view.points_target.astype(np.float32) for view in views],
        [view.points_px.astype(np.float32) for view in views],
        size,
        np.eye(3),
        None,
        flags=flags,
    )
    return 0.5 * float(matrix[0, 0] + matrix[1, 1])
