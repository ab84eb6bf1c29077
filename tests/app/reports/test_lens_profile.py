"""The radial profile of lens models: bins by radius, means with their errors, and what the description says."""

from __future__ import annotations

import numpy as np
import pytest

from app.reports.camera_plots.lens_profile import LensProfile, lens_profile_svg
from app.reports.camera_plots.radial_bins import BINS, RadialResiduals, radial_bins


def model(name: str, slope: float, fold_px: float | None = None) -> RadialResiduals:
    rng = np.random.default_rng(1)
    radius = np.sqrt(rng.uniform(0.0, 500.0**2, 4000))
    return RadialResiduals(name, radius, slope * radius + rng.normal(0.0, 0.1, 4000), 0.1, fold_px)


def test_bins_hold_the_mean_within_its_error() -> None:
    bins = radial_bins(model("brown", 1e-3), 500.0)
    # The innermost bin has 500² / 24² of the points, some seven: too few.
    assert BINS - 2 <= len(bins.middle_px) < BINS
    z = (bins.mean_px - 1e-3 * bins.middle_px) / bins.error_px
    assert float(np.mean(z**2)) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / len(z)))
    assert radial_bins(model("brown", 0.0), 1.0).middle_px.size == 0


def test_the_description_says_which_model_was_chosen_and_which_turns_back() -> None:
    models = [model("brown", 1e-3, 520.0), model("kannala_brandt", 0.0)]
    profile = LensProfile("wide", 12, "kannala_brandt", "w 400, share 30.0 %.", 499.0, models)
    text = lens_profile_svg([profile], "Lens models").decode()
    assert "wide: Kannala-Brandt lens model, 12 images; points reach 499 px" in text
    assert "Brown: 0.1 px rms, turns back at 520 px" in text
    assert lens_profile_svg([profile], "Lens models").decode() == text
