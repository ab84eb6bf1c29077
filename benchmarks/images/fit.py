"""The fit of one image: its time compared with OpenCV's, what it accepts, and the coverage of its intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from statistics import median

import cv2
import numpy as np
from scipy.special import chdtri

from benchmarks.conditions import one_core, seconds
from benchmarks.table import Row
from core import Calibration, Camera, calibrate_points
from core.calibration.priors import ASPECT_PRIOR
from core.errors import FocalNotObservable, GridposeError
from core.geometry import invert, so3_log
from tests.support.simulation.simulated_views import View, draw_camera, draw_view

NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "x", "y", "z", "wx", "wy", "wz")
GRIDS = ((9, 6), (14, 10), (25, 18))
NOISES_PX = (0.02, 0.05, 0.1)
TILTS_DEG = (0.0, 2.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0)


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    yield from _time(seeds, 5 if quick else 40)
    yield from _mixture(seeds, 400 if quick else 24_000)
    yield from _beyond_the_priors(seeds, 20 if quick else 500)


def _time(seeds: list[int], repeats: int) -> Iterable[Row]:
    views = [
        draw_view(np.random.default_rng(seed), columns=25, rows=18, tilt_deg=tilt)
        for seed in seeds
        for tilt in (20.0, 30.0, 45.0)
    ]
    ours: list[float] = []
    theirs: list[float] = []
    with one_core():
        for view in views:  # caches and code paths warm
            calibrate_points(view.points)
            _opencv(view)
        for _ in range(repeats):
            for view in views:
                ours.append(seconds(lambda v=view: calibrate_points(v.points)))
                theirs.append(seconds(lambda v=view: _opencv(v)))
    note = f"450 points, start included; {len(views)} views × {repeats}, in turns, one core, medians"
    yield Row.at_most("fit alone", 1e3 * median(ours), 1.5, "ms", note)
    yield Row.context("cv2.calibrateCamera, 450 points", 1e3 * median(theirs), "ms", note)
    yield Row.at_most("fit alone ÷ cv2.calibrateCamera", median(ours) / median(theirs), 0.5, note=note)


@dataclass(frozen=True)
class _Accepted:
    tilt_deg: float
    determined: bool
    focal_error: float
    z: np.ndarray
    position_square: float
    """The squared error of the position by its covariance: a χ² of three degrees of freedom, were all linear."""


def _mixture(seeds: list[int], count: int) -> Iterable[Row]:
    """All grids, noises and tilts in equal parts; cameras drawn from the priors."""
    accepted: list[_Accepted] = []
    refused = dict.fromkeys(TILTS_DEG, 0)
    total = dict.fromkeys(TILTS_DEG, 0)
    other = 0
    cells = [(g, n, t) for g in GRIDS for n in NOISES_PX for t in TILTS_DEG]
    for seed in seeds:
        rng = np.random.default_rng(seed)
        for _ in range(max(1, count // (len(seeds) * len(cells)))):
            for (columns, grid_rows), noise, tilt in cells:
                view = draw_view(
                    rng,
                    columns=columns,
                    rows=grid_rows,
                    sigma_px=noise,
                    tilt_deg=tilt,
                    camera=_of_the_priors(rng),
                )
                total[tilt] += 1
                try:
                    found = calibrate_points(view.points)
                except FocalNotObservable:
                    refused[tilt] += 1
                except GridposeError:
                    other += 1
                else:
                    accepted.append(_compare(view, found, tilt))
    determined = np.array([a.determined for a in accepted])
    errors = np.array([a.focal_error for a in accepted])
    note = f"{sum(total.values()):,} views, {int(determined.sum()):,} determined, {int((~determined).sum()):,} weak"
    wrong = float(np.sum(errors[determined] > 0.1))
    yield Row.at_most("determined fits off by more than 10 % in f", wrong, 0.0, note=note)
    yield Row.context("worst determined error of f", 100 * float(errors[determined].max()), "%", note)
    yield Row.at_least("determined fits looked at", float(determined.sum()), 10_000.0)
    yield Row.context(
        "weak fits off by more than 30 % in f", 100 * float(np.mean(errors[~determined] > 0.3)), "%", note
    )
    yield Row.at_most("fits that ended in any other failure", float(other), 0.0, note=note)
    share = ", ".join(
        f"{t:.0f}°: {100 * sum(a.determined for a in accepted if a.tilt_deg == t) / total[t]:.0f} / "
        f"{100 * (1 - refused[t] / total[t]):.0f} %"
        for t in TILTS_DEG
    )
    yield Row(
        "views determined / answered, by tilt", share, note="the rest is refused: focal length not observable"
    )
    z = np.array([a.z for a in accepted if a.tilt_deg >= 10.0])
    coverage = np.mean(np.abs(z) < 1.959964, axis=0)
    spread = f"{len(z):,} views at 10-60°; standard error {100 * np.sqrt(0.95 * 0.05 / len(z)):.2f} %"
    yield Row.within(
        "coverage of 95 % intervals, mean", 100 * float(coverage.mean()), 93.0, 97.0, "%", spread
    )
    for label, index in (("lowest", int(coverage.argmin())), ("highest", int(coverage.argmax()))):
        yield Row.within(
            f"coverage, {label} parameter ({NAMES[index]})",
            100 * float(coverage[index]),
            93.0,
            97.0,
            "%",
            spread,
        )
    for name, kind in (("determined", True), ("weak", False)):
        squares = [a.position_square for a in accepted if a.determined == kind and a.tilt_deg >= 10.0]
        held = 100.0 * float(np.mean(np.array(squares) < chdtri(3.0, 0.05)))
        note = f"{len(squares):,} views at 10-60°; an ellipsoid about the valley of f is wider than it"
        yield Row.at_least(
            f"95 % region of the position, x, y, z together, holds: {name}", held, 93.0, "%", note
        )


def _of_the_priors(rng: np.random.Generator) -> Camera:
    """Draw a camera whose fx/fy is from the prior, too; `draw_camera` has it within .1 %."""
    usual = draw_camera(rng)
    return dataclasses.replace(usual, fy_px=usual.fx_px * float(np.exp(rng.normal(0.0, ASPECT_PRIOR))))


def _beyond_the_priors(seeds: list[int], count: int) -> Iterable[Row]:
    """Cameras and prints that single images do not assume: what then is off, and how much of it is remarked on."""
    determined, wrong, unremarked = 0, 0, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        for _ in range(count):
            usual = draw_camera(rng)
            angle = rng.uniform(0.0, 2.0 * np.pi)
            odd = dataclasses.replace(
                usual,
                cx_px=usual.cx_px + 0.03 * 2448 * np.cos(angle),
                cy_px=usual.cy_px + 0.03 * 2448 * np.sin(angle),
                fy_px=usual.fx_px * (1.0 + rng.choice([-0.003, 0.003])),
            )
            view = draw_view(rng, tilt_deg=rng.uniform(10.0, 60.0), camera=odd)
            try:
                found = calibrate_points(view.points)
            except FocalNotObservable:
                continue
            if found.grade != "determined":
                continue
            determined += 1
            result = _compare(view, found, 0.0)
            wrong += result.focal_error > 0.1
            far = bool(np.any(np.abs(result.z) > 3.0))
            unremarked += far and "prior_residuals_large" not in {w.code for w in found.warnings}
    note = f"principal point 3 % of the width off, fx/fy .3 % off; {determined:,} determined views at 10-60°"
    yield Row.context(
        "beyond the priors: determined fits off by more than 10 % in f", float(wrong), note=note
    )
    share = 100.0 * unremarked / max(determined, 1)
    yield Row.context(
        "beyond the priors: a figure off by 3 u without `prior_residuals_large`", share, "%", note
    )


def _compare(view: View, found: Calibration, tilt_deg: float) -> _Accepted:
    truth, estimate = view.camera.as_array()[:8], found.camera.as_array()[:8]
    T = invert(view.T_camera_target)
    position = T[:3, 3] - found.pose.position_mm
    pose = np.concatenate([position, so3_log(T[:3, :3] @ found.pose.rotation.T)]) / np.sqrt(
        np.diag(found.pose.covariance)
    )
    camera = (truth - estimate) / found.camera_standard_uncertainty[:8]
    return _Accepted(
        tilt_deg,
        found.grade == "determined",
        abs(estimate[0] / truth[0] - 1.0),
        np.concatenate([camera, pose]),
        float(position @ np.linalg.solve(found.pose.covariance[:3, :3], position)),
    )


def _opencv(view: View) -> None:
    cv2.calibrateCamera(
        [view.points.points_target.astype(np.float32)],
        [view.points.points_px.astype(np.float32)],
        (view.points.image_width_px, view.points.image_height_px),
        None,
        None,
        flags=cv2.CALIB_FIX_K3,
    )
