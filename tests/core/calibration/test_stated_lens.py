"""A stated lens: used where it fits, rejected with a warning where the images say otherwise, whatever the estimator."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.priors import Lens
from tests.support.simulation.robots.resting_robot import session

PITCH_UM = 3.45
SESSION = session(21, poses=5, cycles=2)
TILTED = session(21, poses=5, cycles=2, tilt_deg=50.0)
"""Every image determines its camera by itself."""


def lens(factor: float) -> Lens:
    """A lens of so many times the true focal length."""
    return Lens(factor * SESSION.camera.fx_px * PITCH_UM / 1000.0, PITCH_UM)


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["pooled", "pooled_free_focal", "per_image", "per_image_fixed_pp"])
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_one_that_the_images_contradict_is_rejected(estimator: str, factor: float) -> None:
    """Binning by two, the usual mistake."""
    images = TILTED if estimator == "per_image" else SESSION
    without = estimate_group(images.views, estimator, repeats=images.labels)
    found = estimate_group(images.views, estimator, repeats=images.labels, lens=lens(factor))
    (warning,) = [w for w in found.warnings if w.code == "focal_prior_inconsistent"]
    assert f"stated lens {lens(factor).focal_px:.0f} px" in warning.detail
    assert ("10 of 10 images" in warning.detail) == estimator.startswith("per_image")
    assert warning.advice
    u = np.sqrt(np.einsum("kii->ki", without.covariance))[:, :3]
    assert np.max(np.abs(found.positions_mm - without.positions_mm) / u) < 0.05
    np.testing.assert_allclose(
        np.diag(found.camera_covariance), np.diag(without.camera_covariance), rtol=0.05, atol=1e-20
    )


@pytest.mark.parametrize("estimator", ["pooled", "pooled_free_focal", "per_image", "per_image_fixed_pp"])
def test_one_that_is_good_to_five_per_cent_is_taken_without_a_word(estimator: str) -> None:
    for factor in (0.95, 1.0, 1.07):
        found = estimate_group(SESSION.views, estimator, repeats=SESSION.labels, lens=lens(factor))
        assert "focal_prior_inconsistent" not in {w.code for w in found.warnings}
        assert len(found.images) == 10
