"""Photographs that others took, each by itself, against the camera that the set's other photographs determine.

Held-out split: the reference of a photograph is the focal length of OpenCV's multi-view calibration of all *other*
photographs of its set, on the same grid points. Nothing of the fit was chosen on these sets: its priors are from
published calibrations of other cameras. The references have uncertainties of their own, so that a row says how errors
compare with both. The estimator `per_image_session_prior` is measured on all photographs, too: its lens is that of the
set's other photographs; with a lens beyond Brown's model the reference is Gridpose's own pooled camera of these. The
naive recipe is `cv2.calibrateCamera` on the one view, principal point held at the centre, square pixels, no tangential
distortion.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.table import Row
from core import calibrate_points
from core.calibration import calibrate_views, estimate_group, number_labels, select_lens, stack_views
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
    of_reference: float
    """Relative standard uncertainty of the reference's focal length, as Gridpose's pooled fit of these views has it."""


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    del seeds  # nothing here is drawn
    folder = Path(
        os.environ.get("GRIDPOSE_TEST_DATA", Path(__file__).parents[3] / "shared" / "data"),
    )
    if not folder.is_dir():
        yield Row("photographs", "not here", note="set GRIDPOSE_TEST_DATA to their folder")
        return
    everything: list[_Answer] = []
    with_prior: list[_Answer] = []
    for name in list(SETS)[:1] if quick else SETS:
        views = detected(folder, name)
        answers, others = _of_set(views), _with_session_prior(views)
        everything += answers
        with_prior += others
        yield from _rows_of(name, answers)
        yield from _rows_with_prior(name, others)
        yield _pooled_row(name, views)
    answered = sum(a.ours is not None for a in everything)
    yield Row.at_least(
        "photographs answered", 100.0 * answered / len(everything), 95.0, "%", "each by itself"
    )
    yield from _rows_of("all", everything)
    largest = max(abs(a.ours / a.uncertainty) for a in everything if a.ours and a.uncertainty)
    yield Row.at_most("all: largest error of f ÷ u(f)", largest, 3.0)
    yield from _rows_with_prior("all", with_prior)
    if quick:
        return
    of_prior = np.array([a.ours for a in with_prior if a.ours is not None])
    u = np.array([a.uncertainty for a in with_prior if a.uncertainty is not None])
    share = 100.0 * len(of_prior) / len(with_prior)
    yield Row.at_least("per_image_session_prior: photographs answered", share, 95.0, "%")
    held = 100.0 * float(np.mean(np.abs(of_prior / u) < 1.959964))
    yield Row.within("per_image_session_prior: 95 % interval of f holds", held, 90.0, 98.0, "%")


def detected(folder: Path, name: str) -> list[GridPoints]:
    """Return the grid points of every photograph of a set."""
    pattern, target = SETS[name]
    return [detect(decode(path.read_bytes()), target) for path in sorted(folder.glob(pattern))]


def _of_set(views: list[GridPoints]) -> list[_Answer]:
    answers = []
    for i, points in enumerate(views):
        others = [view for k, view in enumerate(views) if k != i]
        reference, of_reference = _focal(others, 0), _pooled_uncertainty(others)
        naive = _focal([points], NAIVE) / reference - 1.0
        try:
            found = calibrate_points(points)
        except GridposeError:
            answers.append(_Answer(naive, None, None, of_reference))
            continue
        focal = 0.5 * (found.camera.fx_px + found.camera.fy_px)
        answers.append(
            _Answer(
                naive,
                focal / reference - 1.0,
                found.observability.focal_relative_uncertainty,
                of_reference,
            )
        )
    return answers


def _pooled_uncertainty(views: list[GridPoints]) -> float:
    found = calibrate_views(views)
    variance = 0.25 * float(np.sum(found.covariance[:2, :2]))
    return math.sqrt(variance) / (0.5 * (found.camera.fx_px + found.camera.fy_px))


def _with_session_prior(views: list[GridPoints]) -> list[_Answer]:
    """Return every photograph's focal length with the lens of the others as its prior."""
    stack = stack_views(views)
    choice = select_lens(stack, number_labels(range(len(stack))), None, estimate_group(stack, "pooled"))
    found = estimate_group(stack, "per_image_session_prior", lens_start=choice.start)
    assert found.focal_uncertainty is not None
    place = {int(image): k for k, image in enumerate(found.images)}
    answers = []
    for i in range(len(views)):
        others = [k for k in range(len(views)) if k != i]
        if choice.start is None:
            reference = _focal([views[k] for k in others], 0)
        else:
            pooled = estimate_group(stack.take(others), "pooled", lens_start=choice.start).camera
            reference = 0.5 * (pooled.fx_px + pooled.fy_px)
        if i not in place:
            answers.append(_Answer(math.nan, None, None, math.nan))
            continue
        focal = 0.5 * float(found.cameras[place[i], :2].sum())
        u = float(found.focal_uncertainty[place[i]])
        answers.append(_Answer(math.nan, focal / reference - 1.0, u, math.nan))
    return answers


def _pooled_row(name: str, views: list[GridPoints]) -> Row:
    """Return how far the session's camera is from OpenCV's of the same views, by the lens model that each needs."""
    stack = stack_views(views)
    choice = select_lens(stack, number_labels(range(len(stack))), None, estimate_group(stack, "pooled"))
    camera = estimate_group(stack, "pooled", lens_start=choice.start).camera
    theirs = _focal(views, 0) if choice.start is None else fisheye_by_opencv(views)[0]
    off = 100.0 * abs(0.5 * (camera.fx_px + camera.fy_px) / theirs - 1.0)
    return Row.at_most(f"{name}: pooled f less OpenCV's, relative", off, 0.5, "%", f"lens: {choice.model}")


def _rows_with_prior(name: str, answers: list[_Answer]) -> Iterable[Row]:
    ours = np.array([a.ours for a in answers if a.ours is not None])
    u = np.array([a.uncertainty for a in answers if a.uncertainty is not None])
    note = (
        f"{len(ours)} of {len(answers)} answered; median relative error {100 * np.median(abs(ours)):.3g} %; "
        f"largest {np.max(np.abs(ours / u)):.3g}; median u {100 * np.median(u):.3g} %"
    )
    rms = float(np.sqrt(np.mean((ours / u) ** 2)))
    yield Row.context(f"{name}: rms of Δf/u(f), per_image_session_prior", rms, note=note)


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
    of_both = np.hypot(u, [a.of_reference for a in answers if a.ours is not None])
    both = float(np.sqrt(np.mean((ours / of_both) ** 2)))
    yield Row.context(f"{name}: rms of Δf over u(f) and that of the reference", both)
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


def fisheye_by_opencv(views: list[GridPoints]) -> tuple[float, float]:
    """Return the mean of fx and fy by cv2.fisheye.calibrate, and its residuals' rms in u and v, px."""
    rms, matrix, *_ = cv2.fisheye.calibrate(
        [view.points_target.reshape(1, -1, 3) for view in views],
        [view.points_px.reshape(1, -1, 2) for view in views],
        (views[0].image_width_px, views[0].image_height_px),
        np.eye(3),
        np.zeros(4),
        flags=cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW,
    )
    return 0.5 * float(matrix[0, 0] + matrix[1, 1]), float(rms)
