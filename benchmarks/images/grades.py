"""Grades of single images: do the intervals of focal length and position hold the truth, by u(f)/f and by lens?

Cameras are drawn from the very priors that the fit assumes (lenses that fold back within the image are drawn again), so
that a 95 % interval has to hold 95 % of the truths. The noise is white.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from benchmarks.table import Row
from core import Calibration, calibrate_points
from core.calibration import MAX_FOCAL_UNCERTAINTY
from core.errors import FocalNotObservable, GridposeError
from core.geometry import invert
from tests.support.simulation.simulated_views import View, draw_view_from_priors

UNCERTAINTIES = (0.0, 0.02, 0.05, 0.10, MAX_FOCAL_UNCERTAINTY)
LENSES = (0.0, 0.6, 1.0, 1.6, math.inf)
"""Focal lengths over the image's longer side that bound the cells."""
GRIDS = ((9, 6), (14, 10))
MAX_TILT_DEG = 35.0  # from 1°, small ones the more often
NOISES_PX = (0.02, 0.05, 0.1, 0.2)


@dataclass(frozen=True)
class _Answer:
    uncertainty: float  # u(f)/f
    lens: float  # the estimated f / the longer side
    within: tuple[bool, bool, bool, bool]
    """Whether the truth lies in the intervals of fx, x, y, z."""
    line_of_sight: bool
    relative_error: float


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    answers: list[_Answer] = []
    refused, other = 0, 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        for _ in range((300 if quick else 18_000) // len(seeds)):
            columns, grid_rows = GRIDS[rng.integers(len(GRIDS))]
            view = draw_view_from_priors(
                rng,
                columns=columns,
                rows=grid_rows,
                tilt_deg=math.exp(rng.uniform(0.0, math.log(MAX_TILT_DEG))),
                sigma_px=NOISES_PX[rng.integers(len(NOISES_PX))],
            )
            try:
                answers.append(_answer(view, calibrate_points(view.points)))
            except FocalNotObservable:
                refused += 1
            except GridposeError:
                other += 1
    note = f"{refused:,} of {refused + other + len(answers):,} views refused as focal_not_observable"
    yield Row.at_most("fits that ended in any other failure", float(other), 0.0, note=note)
    for low, high in itertools.pairwise(UNCERTAINTIES):
        cell = [a for a in answers if low < a.uncertainty <= high]
        yield from _coverage(f"u(f)/f {100 * low:.0f}-{100 * high:.0f} %", cell)
    weak = [a for a in answers if a.uncertainty > UNCERTAINTIES[1]]
    for low, high in itertools.pairwise(LENSES):
        cell = [a for a in weak if low < a.lens <= high]
        yield from _coverage(f"weak, f {low:g}-{high:g} of the longer side", cell)
    determined = [a.relative_error for a in answers if a.uncertainty <= UNCERTAINTIES[1]]
    yield Row.at_most(
        "determined, off by more than 10 % in f",
        float(np.sum(np.array(determined) > 0.1)),
        0.0,
        note=f"{len(determined):,} views",
    )


def _answer(view: View, found: Calibration) -> _Answer:
    (low, high), _ = found.focal_interval_95
    position = invert(view.T_camera_target)[:3, 3]
    error, C = position - found.pose.position_mm, found.pose.covariance[:3, :3]
    x, y, z = (np.abs(error) < 1.959964 * np.sqrt(np.diag(C))).tolist()
    sight = position / np.linalg.norm(position)
    along = abs(float(sight @ error)) < 1.959964 * math.sqrt(float(sight @ C @ sight))
    return _Answer(
        found.observability.focal_relative_uncertainty,
        found.camera.fx_px / max(found.image_width_px, found.image_height_px),
        (low <= view.camera.fx_px <= high, x, y, z),
        along,
        abs(found.camera.fx_px / view.camera.fx_px - 1.0),
    )


def _coverage(what: str, cell: list[_Answer]) -> Iterable[Row]:
    if not cell:
        return
    error = 100.0 * math.sqrt(0.95 * 0.05 / len(cell))
    note = f"{len(cell):,} views; standard error {error:.2f} %"
    within = 100.0 * np.mean([a.within for a in cell], axis=0)
    yield Row.within(f"{what}: 95 % interval of f holds", float(within[0]), 93.0, 97.0, "%", note)
    names = ", ".join(f"{n} {v:.1f}" for n, v in zip("xyz", within[1:], strict=True))
    along = 100.0 * float(np.mean([a.line_of_sight for a in cell]))
    yield Row.within(f"{what}: 95 % interval of distance holds", along, 93.0, 97.0, "%", f"{note}; {names}")
