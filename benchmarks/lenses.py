"""Lens models of sessions: false alarms, power, coverage with the true model drawn, and photographs by others.

Sessions are points drawn before a camera from the priors of its model's fit (1280 x 960, noise .05 px), the board in
all parts of the image. Held-out figures of the photographs are of five folds, with only the pose fitted.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from benchmarks.images.photographs import SETS, detected, fisheye_by_opencv
from benchmarks.table import Row
from core.calibration import GroupEstimate, estimate_group
from core.geometry import LensModel, invert, lens_model_of
from core.targets import GridPoints
from tests.support.simulation.wide_lenses import WideSession, choose_lens, draw_session

SESSIONS, QUICK_SESSIONS = 60, 6
IMAGES = 10


def rows(seeds: list[int], quick: bool) -> Iterable[Row]:
    count = QUICK_SESSIONS if quick else SESSIONS
    rngs = [np.random.default_rng([seed, 27]) for seed in seeds]
    yield from _of_brown(rngs, count)
    models: tuple[LensModel, ...] = ("kannala_brandt", "rational")
    for model in models:
        yield from _of_wide(rngs, model, count)
    folder = Path(os.environ.get("GRIDPOSE_TEST_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        yield Row("photographs", "not here", note="set GRIDPOSE_TEST_DATA to their folder")
        return
    for name in ["GoPro"] if quick else SETS:
        yield from _of_photographs(name, detected(folder, name))


def _of_brown(rngs: list[np.random.Generator], count: int) -> Iterable[Row]:
    for bow_mm in (0.0, 0.1):
        alarms = [
            choose_lens(draw_session(rng, "brown", images=int(rng.integers(2, 13)), bow_mm=bow_mm).views)[
                0
            ].model
            != "brown"
            for rng in rngs
            for _ in range(count)
        ]
        what = f"false alarms, Brown lens, 2-12 poses, board bowed by {bow_mm:g} mm"
        yield Row.at_most(what, 100.0 * float(np.mean(alarms)), 1.0, "%", f"{len(alarms)} sessions")


def _of_wide(rngs: list[np.random.Generator], model: LensModel, count: int) -> Iterable[Row]:
    found, beyond, focal, positions = 0, 0, [], []
    for rng in rngs:
        for _ in range(count):
            session = draw_session(rng, model, images=IMAGES)
            choice, _ = choose_lens(session.views)
            found += choice.model != "brown"
            beyond += choice.evidence is not None and choice.evidence.beyond_brown
            _, estimate = choose_lens(session.views, model)
            if lens_model_of(estimate.camera) == model:
                focal.append(_focal_error(session, estimate))
                positions += _position_errors(session, estimate)
    total = len(rngs) * count
    yield Row.context(
        f"{model} lens found",
        100.0 * found / total,
        "%",
        f"{total} sessions of {IMAGES} poses; {beyond} by the test",
    )
    what = f"{model} lens, true model"
    z = np.array(focal)
    note = f"{len(z)} of {total} fitted"
    yield Row.within(f"{what}: coverage of f", 100.0 * float(np.mean(abs(z) < 1.96)), 90, 98, "%", note)
    yield Row.within(f"{what}: rms of Δf/u(f)", float(np.sqrt(np.mean(z**2))), 0.8, 1.2)
    covered = 100.0 * float(np.mean(np.array(positions) < 7.815))  # χ²₃ at 95 %
    yield Row.within(f"{what}: coverage of positions", covered, 90, 98, "%")


def _of_photographs(name: str, views: list[GridPoints]) -> Iterable[Row]:
    choice, chosen = choose_lens(views)
    brown = estimate_group(views, "pooled")
    evidence = choice.evidence
    assert evidence is not None, name
    held = "-" if evidence.held_out is None else f"{evidence.held_out:.3f}"
    note = f"w {evidence.statistic:.0f}, share {100.0 * evidence.share:.1f} %, held-out ratio {held}"
    expected = "kannala_brandt" if name == "GoPro" else "brown"
    yield Row(f"{name}: lens model", choice.model, expected, choice.model == expected, note)
    if choice.model == "brown":
        return
    browns, ours = (float(np.sqrt(np.mean(one.rms_px**2))) for one in (brown, chosen))
    yield Row.at_most(f"{name}: rms of pooled residuals", ours, browns, "px", "limit: with Brown's model")
    f = 0.5 * (chosen.camera.fx_px + chosen.camera.fy_px)
    theirs, rms = fisheye_by_opencv(views)
    u = 0.5 * math.sqrt(float(chosen.camera_covariance[:2, :2].sum()))
    what = f"{name}: f less OpenCV's fisheye, of u"
    yield Row.at_most(
        what, abs(f - theirs) / u, 2.0, note=f"{f:.1f} ± {u:.1f}; theirs {theirs:.1f}, rms {rms:.3f} px"
    )


def _focal_error(session: WideSession, found: GroupEstimate) -> float:
    off = found.camera.fx_px - session.camera.fx_px
    return off / math.sqrt(float(found.camera_covariance[0, 0]))


def _position_errors(session: WideSession, found: GroupEstimate) -> list[float]:
    errors = []
    for k, i in enumerate(found.images.tolist()):
        off = found.positions_mm[k] - invert(session.T_camera_target[i])[:3, 3]
        errors.append(float(off @ np.linalg.solve(found.covariance[k, :3, :3], off)))
    return errors
