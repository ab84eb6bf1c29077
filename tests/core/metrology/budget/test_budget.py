"""Budgets by the GUM against its own worked example, closed forms, and sampling."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.metrology import PoseCycles, assess_distance, assess_repeatability, distance_budget
from core.metrology.accuracy import DeviationParts, DeviationSpread
from core.metrology.budget import (
    FORM_OF_NOISE,
    Contribution,
    Distribution,
    Evaluation,
    accuracy_budget,
    combined,
    corrected_budget,
    floor_budget,
    repeatability_budget,
)


def _input(
    u: float, freedom: float | None = None, sensitivity: float = 1.0, source: str = "cycles"
) -> Contribution:
    return Contribution(source, Evaluation.A, Distribution.NORMAL, u, "mm", sensitivity, freedom)


def test_end_gauge_of_the_gum() -> None:
    """GUM H.1: u_c = 32 nm with 16 (truncated) effective degrees of freedom, here k at 95 %."""
    parts = [_input(25.0, 18.0), _input(9.7, 25.6), _input(2.9, 50.0), _input(16.6, 2.0)]
    found = combined(0.0, parts)
    assert found.standard_uncertainty_mm == pytest.approx(31.7, abs=0.1)
    assert found.effective_degrees_of_freedom == pytest.approx(16.7, abs=0.8)
    assert found.coverage_factor == pytest.approx(2.11, abs=0.02)
    assert sum(found.share(one) for one in parts) == pytest.approx(1.0)


def test_sampling_agrees_where_the_model_is_linear_and_normal() -> None:
    rng = np.random.default_rng(0)
    draws = 5.0 + 0.03 * rng.standard_normal(100_000) - 2.0 * 0.02 * rng.standard_normal(100_000)
    found = combined(5.0, [_input(0.03), _input(0.02, sensitivity=-2.0)], draws)
    assert found.standard_uncertainty_mm == pytest.approx(0.05)
    assert found.effective_degrees_of_freedom is None
    assert found.agreement is not None
    assert found.agreement.agrees
    assert found.agreement.tolerance_mm == pytest.approx(0.005)
    skewed = combined(5.0, [_input(0.05)], 5.0 + 0.05 * (rng.chisquare(1.0, 100_000) - 1.0))
    assert skewed.agreement is not None
    assert not skewed.agreement.agrees


def test_no_uncertainty_is_no_obstacle() -> None:
    found = combined(1.0, [_input(0.0, 4.0)], np.full(10, 1.0))
    assert found.expanded_uncertainty_mm == 0.0
    assert found.agreement is not None
    assert found.agreement.agrees
    assert found.share(found.contributions[0]) == 0.0


def test_repeatability_has_the_width_of_its_interval_and_the_scale() -> None:
    found = repeatability_budget(0.1, (0.08, 0.13), 1e-3, None)
    cycles, scale = found.contributions
    spread = math.log(0.13 / 0.08) / (2.0 * 1.959964)
    assert cycles.standard_uncertainty_mm == pytest.approx(0.1 * spread)
    assert cycles.degrees_of_freedom == pytest.approx(0.5 / spread**2)
    assert scale.unit == "1"
    assert scale.standard_uncertainty_mm == pytest.approx(1e-4)
    unstated = repeatability_budget(0.1, (0.08, 0.13), None, None)
    assert [one.source for one in unstated.contributions] == ["cycles"]


def test_three_sigma_of_a_sphere_has_the_degrees_of_freedom_of_its_cycles() -> None:
    """A needle of 31 cycles has thirty; a sphere three times as many, less what its shape takes."""
    rng = np.random.default_rng(2)
    for shape, freedom in (((1.0, 1e-3, 1e-3), 30.0), ((1.0, 1.0, 1.0), 60.0)):
        found = []
        for _ in range(40):
            one = assess_repeatability([PoseCycles(rng.standard_normal((31, 3)) * shape)])[0]
            reading, interval = one.repeatability.position_mm, one.interval.position_mm
            assert reading is not None
            assert interval is not None
            found.append(repeatability_budget(reading, interval, None, None).effective_degrees_of_freedom)
        assert np.median([one for one in found if one is not None]) == pytest.approx(freedom, rel=0.3)


def test_floor_and_corrected_reading() -> None:
    floor = floor_budget(0.02, 50, None, 50_000)
    size, form = floor.contributions
    assert size.standard_uncertainty_mm == pytest.approx(0.002)
    assert form.standard_uncertainty_mm == pytest.approx(FORM_OF_NOISE * 0.02)
    assert floor.agreement is not None
    assert floor.agreement.standard_uncertainty_mm == pytest.approx(floor.standard_uncertainty_mm, rel=0.05)
    corrected = math.sqrt(0.05**2 - 0.02**2)
    rng = np.random.default_rng(1)
    found = corrected_budget(
        corrected, 0.05, (0.042, 0.06), 0.02, 50, None, 0.05 * np.exp(0.09 * rng.standard_normal(50_000))
    )
    by_source = {one.source: one for one in found.contributions}
    assert by_source["cycles"].sensitivity == pytest.approx(0.05 / corrected)
    assert by_source["noise_size"].sensitivity == pytest.approx(-0.02 * 0.02 / corrected)
    assert found.agreement is not None
    assert found.agreement.standard_uncertainty_mm == pytest.approx(found.standard_uncertainty_mm, rel=0.1)


def test_accuracy_takes_its_inputs_along_the_deviation() -> None:
    shared = np.array([[0.03, 0.0, 0.01], [0.0, 0.04, 0.0], [0.0, 0.0, 0.0]])
    spread = DeviationSpread(np.array([2.0]), np.zeros(1), 200.0)
    parts = DeviationParts(np.array([1.0, 0.0, 0.0]), np.eye(3), 4e-4 * np.eye(3), shared, 30.0, spread)
    found = accuracy_budget(1.0, parts, ("lens", "lens", "print_scale"), 100_000)
    u = {one.source: one.standard_uncertainty_mm for one in found.contributions}
    assert u == pytest.approx({"frame_tie": 0.1, "mean_of_visits": 0.02, "lens": 0.03, "print_scale": 0.01})
    assert found.agreement is not None
    assert found.agreement.agrees


def test_distance() -> None:
    rng = np.random.default_rng(4)
    first = PoseCycles(rng.normal(0.0, 0.02, (30, 3)))
    second = PoseCycles(np.array([300.0, 0.0, 0.0]) + rng.normal(0.0, 0.02, (30, 3)))
    common = np.zeros((6, 2))
    common[0] = [0.05, 0.03]
    assessed = assess_distance(
        first, second, np.zeros(3), np.array([300.0, 0.0, 0.0]), np.zeros((6, 2)), common
    )
    found = distance_budget(assessed, ("print_shape", "print_scale"), 50_000)
    assert found is not None
    by_source = {one.source: one for one in found.contributions}
    assert by_source["print_shape"].standard_uncertainty_mm == pytest.approx(0.05, rel=1e-3)
    assert by_source["print_scale"].input_uncertainty == pytest.approx(1e-4, rel=1e-3)
    assert by_source["print_scale"].sensitivity == pytest.approx(300.0, rel=1e-3)
    assert by_source["cycles"].degrees_of_freedom == 29.0
    assert found.standard_uncertainty_mm == pytest.approx(assessed.standard_uncertainty_mm)
    assert found.agreement is not None
    assert found.agreement.agrees
    assert assessed.accuracy_interval_mm is not None
    assert found.agreement.interval_mm == pytest.approx(assessed.accuracy_interval_mm, abs=0.004)
    uncommanded = assess_distance(first, second)
    assert distance_budget(uncommanded, (), None) is None
