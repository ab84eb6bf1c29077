"""Single images with the lens of the session's other images as their prior."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.single_image import calibrate_points
from core.errors import FocalNotObservable
from core.geometry import (
    AnyCamera,
    KannalaBrandtCamera,
    LensModel,
    invert,
    project_any,
    so3_exp,
    transform,
    transform_points,
)
from core.targets import GridPoints
from tests.support.simulation.wide_lenses import BOARD, draw_session

ESTIMATOR = "per_image_session_prior"


def fronto_parallel(rng: np.random.Generator, like: GridPoints, camera: AnyCamera) -> GridPoints:
    """A view that says next to nothing of the focal length."""
    rotation = so3_exp(np.array([0.02, 0.01, 0.1]))
    middle = BOARD.points_target().mean(axis=0)
    T = transform(rotation, np.array([5.0, -3.0, 350.0]) - rotation @ middle)
    seen = project_any(transform_points(T, BOARD.points_target()), camera)
    return dataclasses.replace(like, points_px=seen + rng.normal(0.0, 0.05, seen.shape))


def errors_of_f(model: LensModel, seeds: range, start: bool) -> list[float]:
    """Errors of each image's focal length in its stated uncertainty."""
    found = []
    for seed in seeds:
        session = draw_session(np.random.default_rng(seed), model, images=7)
        estimate = estimate_group(session.views, ESTIMATOR, lens_start=session.camera if start else None)
        assert estimate.focal_uncertainty is not None
        f = 0.5 * (session.camera.fx_px + session.camera.fy_px)
        off = 0.5 * estimate.cameras[:, :2].sum(axis=1) / f - 1.0
        found += (off / estimate.focal_uncertainty).tolist()
    return found


def test_a_view_that_says_nothing_alone_is_answered_with_the_others_lens() -> None:
    rng = np.random.default_rng(1)
    session = draw_session(rng, "brown", images=6)
    flat = fronto_parallel(rng, session.views[0], session.camera)
    with pytest.raises(FocalNotObservable):
        calibrate_points(flat)
    found = estimate_group([*session.views, flat], ESTIMATOR)
    assert found.images.tolist() == list(range(7))
    assert found.focal_uncertainty is not None
    f = 0.5 * (session.camera.fx_px + session.camera.fy_px)
    off = 0.5 * found.cameras[:, :2].sum(axis=1) / f - 1.0
    assert np.all(np.abs(off) < 4.0 * found.focal_uncertainty)
    assert found.focal_uncertainty[6] > 2.0 * np.median(found.focal_uncertainty)
    for k, T in enumerate(session.T_camera_target):
        error = found.positions_mm[k] - invert(T)[:3, 3]
        assert error @ np.linalg.solve(found.covariance[k, :3, :3], error) < 30.0


def test_a_wide_lens_is_the_prior_in_its_own_model() -> None:
    session = draw_session(np.random.default_rng(3), "kannala_brandt", images=5)
    found = estimate_group(session.views, ESTIMATOR, lens_start=session.camera)
    assert isinstance(found.camera, KannalaBrandtCamera)
    assert len(found.images) == 5
    assert found.focal_uncertainty is not None
    f = 0.5 * (session.camera.fx_px + session.camera.fy_px)
    off = 0.5 * found.cameras[:, :2].sum(axis=1) / f - 1.0
    assert np.all(np.abs(off) < 4.0 * found.focal_uncertainty)
    assert np.all(found.rms_px < 0.1)


def test_a_single_image_has_no_others() -> None:
    session = draw_session(np.random.default_rng(2), "brown", images=1)
    with pytest.raises(FocalNotObservable, match="no other image"):
        estimate_group(session.views, ESTIMATOR)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "seeds"), [("brown", range(20, 35)), ("kannala_brandt", range(20, 28))])
def test_focal_lengths_are_off_by_what_is_stated(model: LensModel, seeds: range) -> None:
    """The images of a session share most of their prior, so that 7 images count as about one and a half."""
    z = errors_of_f(model, seeds, start=model != "brown")
    assert 0.6 < math.sqrt(float(np.mean(np.square(z)))) < 1.35
    assert np.mean(np.abs(z) < 1.96) > 0.85
