"""Uncertainties grow where residuals are not independent, and where they are they do not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.fitting import calibrate_views
from core.calibration.multi_view.group_estimate import GroupEstimate
from tests.support.simulation.robots.resting_robot import Session, errors, estimate, session


def camera_errors(s: Session, found: GroupEstimate) -> np.ndarray:
    """In stated uncertainties."""
    u = np.sqrt(np.diag(found.camera_covariance))[:8]
    return (found.camera.as_array() - s.camera.as_array())[:8] / u


@pytest.mark.slow
@pytest.mark.parametrize(("poses", "cycles"), [(5, 4), (12, 1)])
def test_independent_residuals_leave_uncertainties_alone(poses: int, cycles: int) -> None:
    found = [estimate(session(300 + k, poses=poses, cycles=cycles), "pooled") for k in range(12)]
    inflation = np.array([f.inflation for f in found])
    # The poses' ratio is χ² over its 8 (poses - 1) degrees of freedom; Wiener's factor shrinks what chance adds to 1.
    chance = math.sqrt(2.0 / (8.0 * (poses - 1)))
    assert inflation.min() >= 1.0
    assert inflation.mean() < 1.0 + 0.5 * chance
    assert inflation.max() < math.sqrt(1.0 + 4.0 * chance)
    assert all(not f.warnings for f in found)


@pytest.mark.slow
def test_a_bowed_print_is_in_the_uncertainty_and_not_in_the_scatter() -> None:
    """More images of the same poses say no more of the camera than fewer."""
    z, ratios, positions = [], [], []
    for seed in range(6):
        few = session(310 + seed, poses=6, cycles=2, bow_mm=0.3)
        many = session(310 + seed, poses=6, cycles=12, bow_mm=0.3)
        first, second = estimate(few, "pooled"), estimate(many, "pooled")
        assert "residuals_correlated" in {w.code for w in second.warnings}
        z.append(camera_errors(many, second))
        ratios.append(second.camera_covariance[0, 0] / first.camera_covariance[0, 0])
        e = errors(many, second)[::12]
        positions.append(
            np.mean([x @ np.linalg.solve(C, x) for x, C in zip(e, second.covariance[::12], strict=True)]) / 6
        )
        flat = estimate(session(310 + seed, poses=6, cycles=12), "pooled")
        floors = [np.trace(f.scatter[:, :3, :3].mean(axis=0)) for f in (flat, second)]
        assert floors[1] == pytest.approx(floors[0], rel=0.15)
    # 48 errors that one bow makes, the same in all boards: their rms is 1 but for a factor of two.
    assert 0.4 < float(np.sqrt(np.mean(np.square(z)))) < 2.0, z
    assert 0.2 < float(np.mean(positions)) < 3.0, positions
    # Independent residuals would have it at 1/6.
    assert 0.5 < float(np.median(ratios)) < 2.0, ratios


@pytest.mark.parametrize("estimator", ["given", "per_image_fixed_pp", "pooled_free_focal"])
def test_every_estimator_states_what_neighbours_share(estimator: str) -> None:
    flat, bowed = (estimate(session(320, cycles=4, bow_mm=bow), estimator) for bow in (0.0, 0.4))
    own = [np.trace((f.covariance - f.scatter)[0, :3, :3]) for f in (flat, bowed)]
    assert bowed.inflation > 1.5
    assert own[1] > 4.0 * abs(own[0])


def test_one_pose_is_judged_by_neighbours_alone() -> None:
    flat, bowed = (estimate(session(332, poses=1, cycles=10, bow_mm=bow), "pooled") for bow in (0.0, 0.2))
    assert flat.inflation < 1.25
    assert bowed.inflation > 1.5


def test_a_calibration_of_views_states_the_same() -> None:
    s = session(340, poses=6, cycles=1, bow_mm=0.1)
    calibrated = calibrate_views(s.views)
    pooled = estimate_group(s.views, "pooled")
    np.testing.assert_allclose(calibrated.covariance, pooled.camera_covariance, rtol=1e-9, atol=1e-12)
    assert calibrated.inflation == pytest.approx(pooled.inflation)
    assert pooled.inflation > 1.5


def test_single_images_show_the_way_where_one_pose_is_all_there_is() -> None:
    """From the usual start the pooled fit of this pose does not come to its end."""
    s = session(201, poses=1, cycles=10)
    found = estimate(s, "pooled")
    assert len(found.images) == 10
    assert np.max(np.abs(camera_errors(s, found))) < 4.0
