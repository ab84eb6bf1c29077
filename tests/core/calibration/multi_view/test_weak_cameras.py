"""Cameras that all images together determine weakly: refused for figures of a robot, answered where asked for."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration import MAX_FOCAL_UNCERTAINTY, estimate_group, focal_interval
from core.errors import FocalNotObservable
from tests.support.simulation.simulated_views import View, draw_camera_from_priors, draw_view


def nearly_flat(seed: int, *, tilt_deg: float = 4.0, count: int = 3) -> list[View]:
    rng = np.random.default_rng(seed)
    camera = draw_camera_from_priors(rng)
    tilts = rng.uniform(0.5, tilt_deg, count)
    return [
        draw_view(rng, columns=9, rows=6, tilt_deg=float(tilt), sigma_px=0.1, camera=camera) for tilt in tilts
    ]


@pytest.mark.parametrize("estimator", ["pooled", "pooled_free_focal", "per_image"])
def test_a_weak_camera_is_answered_where_it_is_asked_for(estimator: str) -> None:
    points = [view.points for view in nearly_flat(1, tilt_deg=3.0)]
    with pytest.raises(FocalNotObservable):
        estimate_group(points, estimator)
    found = estimate_group(points, estimator, weak=True)
    assert len(found.images) > 0
    assert "focal_weakly_observable" in {warning.code for warning in found.warnings}
    assert 0.02 < found.focal_relative_uncertainty < MAX_FOCAL_UNCERTAINTY


def test_a_determined_camera_is_the_same_without_a_warning() -> None:
    rng = np.random.default_rng(1)
    camera = draw_camera_from_priors(rng)
    points = [draw_view(rng, tilt_deg=30.0, camera=camera).points for _ in range(2)]
    strict, wide = estimate_group(points, "pooled"), estimate_group(points, "pooled", weak=True)
    assert np.array_equal(strict.camera.as_array(), wide.camera.as_array())
    assert "focal_weakly_observable" not in {warning.code for warning in wide.warnings}


def test_a_focal_length_of_each_image_follows_what_is_shared() -> None:
    """Rms of error ÷ u of images that have their own f but share the rest, 12 sessions of 4: 4 without that part."""
    z = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        camera = draw_camera_from_priors(rng)
        tilts = rng.uniform(5.0, 10.0, 4)
        points = [draw_view(rng, tilt_deg=float(tilt), sigma_px=0.1, camera=camera).points for tilt in tilts]
        found = estimate_group(points, "pooled_free_focal", weak=True)
        off = float(found.camera.as_array()[:2].sum()) / (camera.fx_px + camera.fy_px) - 1.0
        z.append(off / found.focal_relative_uncertainty)
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.7


def test_what_leaves_the_focal_length_open_stays_refused() -> None:
    points = [view.points for view in nearly_flat(1, tilt_deg=0.6, count=1)]
    with pytest.raises(FocalNotObservable, match="the limit is 14 %"):
        estimate_group(points, "pooled", weak=True)


@pytest.mark.slow
def test_intervals_of_weak_cameras_and_their_poses_hold() -> None:
    """Within three standard errors of 95 %: of about 150 sessions for f, of three times as many poses."""
    focal: list[bool] = []
    position: list[bool] = []
    for seed in range(300):
        views = nearly_flat(1000 + seed)
        try:
            found = estimate_group([view.points for view in views], "pooled", weak=True)
        except FocalNotObservable:
            continue
        if found.focal_relative_uncertainty <= 0.02:
            continue
        low, high = focal_interval(found.camera.fx_px, float(np.sqrt(found.camera_covariance[0, 0])))
        focal.append(low <= views[0].camera.fx_px <= high)
        for k, i in enumerate(found.images.tolist()):
            off = found.positions_mm[k] - np.linalg.inv(views[i].T_camera_target)[:3, 3]
            position.append(float(off @ np.linalg.solve(found.covariance[k, :3, :3], off)) < 7.815)
    assert len(focal) > 100
    assert abs(np.mean(focal) - 0.95) < 3.0 * np.sqrt(0.05 * 0.95 / len(focal))
    # The poses of a session share its camera's error.
    assert np.mean(position) > 0.95 - 3.0 * np.sqrt(0.05 * 0.95 / len(focal))
