"""Circles through points in space."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.errors import DegenerateGeometry
from core.geometry.se3 import so3_exp
from core.kinematics.joint_axes.closed_form import fit_circle


def points(arc: float, count: int = 9, radius: float = 250.0) -> np.ndarray:
    angles = np.linspace(0.0, arc, count)
    flat = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
    return flat @ so3_exp(np.array([0.4, -0.7, 0.2])).T + [100.0, -2000.0, 50.0]


@pytest.mark.parametrize("arc", [0.2, 1.4, 5.5])
@pytest.mark.parametrize("count", [3, 9])
def test_exact_points_give_the_circle(arc: float, count: int) -> None:
    circle = fit_circle(points(arc, count))
    np.testing.assert_allclose(circle.centre, [100.0, -2000.0, 50.0], atol=1e-6)
    assert circle.radius == pytest.approx(250.0, abs=1e-6)
    normal = so3_exp(np.array([0.4, -0.7, 0.2])) @ [0.0, 0.0, 1.0]
    assert abs(circle.normal @ normal) == pytest.approx(1.0, abs=1e-12)


def test_the_radius_of_noisy_short_arcs_is_nearly_unbiased() -> None:
    rng = np.random.default_rng(3)
    arc = points(1.0, 40)
    radii = [fit_circle(arc + rng.normal(0.0, 2.0, arc.shape)).radius for _ in range(200)]
    # Kåsa's fit would be some 5 mm short here; 200 trials of 6 mm scatter leave .4 mm.
    assert np.mean(radii) == pytest.approx(250.0, abs=2.0)


@pytest.mark.parametrize("given", [np.zeros((5, 3)), np.outer(np.arange(5.0), [1.0, 2.0, 3.0])])
def test_points_on_a_line_are_refused(given: np.ndarray) -> None:
    with pytest.raises(DegenerateGeometry):
        fit_circle(given)


def test_normal_is_of_unit_length() -> None:
    assert math.isclose(float(np.linalg.norm(fit_circle(points(2.0)).normal)), 1.0, abs_tol=1e-12)
