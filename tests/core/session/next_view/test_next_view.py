"""Suggested views reach a given uncertainty with far fewer images than views at random."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.calibration import GroupEstimate, estimate_group
from core.errors import InvalidArgument
from core.geometry import Camera
from core.session.next_view import (
    camera_information,
    candidate_views,
    projection_jacobian,
    suggest_views,
)
from core.session.next_view.information import simulated_views
from core.targets import GridPoints, TargetSpec

CAMERA = Camera(1150.0, 1155.0, 650.0, 470.0, -0.12, 0.06, 0.0005, -0.0004, 0.0)
SIZE = (1280, 960)
SPEC = TargetSpec("chessboard", 10, 7, 20.0)
NOISE_PX, BEGUN, AT_RANDOM = 0.1, 4, 20


def uncertainty_px(estimate: GroupEstimate) -> float:
    J = projection_jacobian(CAMERA, SIZE, 8)
    return math.sqrt(float(np.sum((J.T @ J / len(J)) * estimate.camera_covariance[:8, :8])))


def taken(seed: int, count: int, rng: np.random.Generator) -> list[GridPoints]:
    at = candidate_views(SPEC, CAMERA, SIZE, count, seed=seed)
    return simulated_views(SPEC, CAMERA, SIZE, at, NOISE_PX, rng)


def test_the_planned_order_needs_six_tenths_of_the_images_of_a_random_one() -> None:
    shares = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        random = taken(1000 + seed, AT_RANDOM, rng)
        aim = uncertainty_px(estimate_group(random, "pooled"))
        views = random[:BEGUN]
        while len(views) < AT_RANDOM:
            found = estimate_group(views, "pooled")
            if uncertainty_px(found) <= aim:
                break
            assert found.fit is not None
            # One at a time, from what is known so far, as one does who stands at the camera.
            one = suggest_views(found.fit, found.camera_covariance, SPEC, 1)
            views = [*views, *simulated_views(SPEC, CAMERA, SIZE, one.T_camera_target, NOISE_PX, rng)]
        shares.append(len(views) / AT_RANDOM)
    print(f"images by the planned order over a random one: {np.round(shares, 2).tolist()}")
    assert np.mean(shares) <= 0.6
    assert max(shares) < 1.0


def test_what_is_predicted_is_what_the_fit_of_all_views_states() -> None:
    rng = np.random.default_rng(7)
    views = taken(5, 12, rng)
    found = estimate_group(views, "pooled")
    assert found.fit is not None
    planned = suggest_views(found.fit, found.camera_covariance, SPEC, 6)
    assert planned.projection_px[0] == pytest.approx(uncertainty_px(found), rel=0.1)
    assert np.all(np.diff(planned.projection_px) < 0.0)
    assert np.all(np.diff(planned.focal_relative) <= 0.0)
    more = [*views, *simulated_views(SPEC, CAMERA, SIZE, planned.T_camera_target, NOISE_PX, rng)]
    assert uncertainty_px(estimate_group(more, "pooled")) == pytest.approx(
        planned.projection_px[-1], rel=0.35
    )


def test_the_information_of_the_views_taken_is_the_inverse_of_what_their_fit_leaves_uncertain() -> None:
    # The fit has priors, which forty views outweigh.
    found = estimate_group(taken(5, 40, np.random.default_rng(7)), "pooled")
    assert found.fit is not None
    information = camera_information(found.fit.views, found.fit.placements).sum(axis=0)
    variances = np.diag(np.linalg.inv(information)) * found.fit.scale**2 * found.fit.growth.camera
    np.testing.assert_allclose(variances, np.diag(found.camera_covariance)[:8], rtol=0.02)


def test_candidates_show_the_whole_target() -> None:
    at = candidate_views(SPEC, CAMERA, SIZE, 50)
    assert len(at) == 50
    for view in simulated_views(SPEC, CAMERA, SIZE, at, NOISE_PX):
        assert np.all(view.points_px >= 0.0)
        assert np.all(view.points_px <= np.array(SIZE) - 1.0)


def test_no_views_are_refused() -> None:
    found = estimate_group(taken(5, 5, np.random.default_rng(1)), "pooled")
    assert found.fit is not None
    with pytest.raises(InvalidArgument):
        suggest_views(found.fit, found.camera_covariance, SPEC, 0)
