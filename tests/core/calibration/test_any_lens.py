"""Wide lenses' residuals, normal equations and descent in numpy: where the models coincide, the compiled ones."""

from __future__ import annotations

import numpy as np
import pytest

from core.calibration.lens_selection.starts import with_camera
from core.calibration.multi_view import Placements, ViewStack, linearise, stack_views
from core.calibration.priors import wide_lens_prior
from core.calibration.residuals import View, descend, residuals_with_jacobian
from core.geometry import AnyCamera, Camera, KannalaBrandtCamera, RationalCamera, so3_exp
from tests.support.simulation.simulated_views import draw_view

BROWN = Camera(2320.0, 2321.0, 1220.0, 1030.0, -0.1, 0.05, 1e-4, -2e-4)
RATIONAL = RationalCamera(*BROWN.as_array()[:8].tolist())
ANGULAR = KannalaBrandtCamera(2320.0, 2321.0, 1220.0, 1030.0, 0.2, 0.03, -0.01, 2e-3, 1e-4, -2e-4)
SHARED = [*range(8), *range(12, 19)]
"""Of the rational model's rows: those that Brown's has, too."""


@pytest.fixture(scope="module")
def seen() -> tuple[ViewStack, Placements]:
    rng = np.random.default_rng(3)
    drawn = [
        draw_view(rng, camera=BROWN, columns=columns, rows=5, tilt_deg=20.0 + i)
        for i, columns in enumerate((6, 41, 6, 6))
    ]
    stack = stack_views([view.points for view in drawn])
    rotations = np.array([so3_exp(rng.normal(0.0, 1e-3, 3)) @ v.T_camera_target[:3, :3] for v in drawn])
    middles = np.array([v.T_camera_target[:3, 3] for v in drawn])
    return stack, Placements(
        np.tile(BROWN.as_array(), (4, 1)),
        rotations,
        middles + np.einsum("kij,kj->ki", rotations, stack.centroids),
    )


@pytest.mark.parametrize("robust", [False, True])
def test_a_rational_lens_without_further_terms_gives_browns_equations(
    seen: tuple[ViewStack, Placements], robust: bool
) -> None:
    views, at = seen
    used = np.arange(len(views.column)) % 7 != 3
    browns = linearise(views, at, used, robust=robust)
    wide = linearise(views, with_camera(at, RATIONAL), used, robust=robust)
    np.testing.assert_allclose(wide.residuals, browns.residuals, atol=1e-9)
    np.testing.assert_allclose(wide.squared, browns.squared, rtol=1e-8)
    unit = np.sqrt(np.einsum("kii->ki", browns.products))
    difference = wide.products[:, SHARED][:, :, SHARED] - browns.products
    np.testing.assert_allclose(difference / (unit[:, :, None] * unit[:, None, :]), 0.0, atol=1e-10)
    np.testing.assert_array_equal(wide.of_poses, wide.products[:, 12:18, 12:18])
    assert wide.cost == pytest.approx(browns.cost, rel=1e-9)


@pytest.mark.parametrize("camera", [ANGULAR, RATIONAL])
def test_derivatives_of_residuals_are_those_of_differences(
    seen: tuple[ViewStack, Placements], camera: AnyCamera
) -> None:
    views, at = seen
    target, observed = (views.points_target[:30] - views.centroids[0]).T, views.points_px[:30].T
    parameters, R, t = camera.as_array(), at.rotations[0], at.translations_mm[0]
    free = len(parameters)
    _, J = residuals_with_jacobian(target, observed, View(parameters, R, t), free)
    for i in range(6):
        w, d = np.zeros(3), np.zeros(3)
        (w if i < 3 else d)[i % 3] = h = 1e-5 if i < 3 else 1e-3
        ahead, behind = (
            residuals_with_jacobian(
                target, observed, View(parameters, so3_exp(sign * w) @ R, t + sign * d), 0
            )[0]
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(J[free + i], (behind - ahead) / (2.0 * h), rtol=1e-5, atol=1e-4)


def test_the_descent_ends_where_the_compiled_one_does(seen: tuple[ViewStack, Placements]) -> None:
    views, at = seen
    part = views.part(1)
    arguments = *views.centred(1, part), np.sqrt(views.weight[part])
    start = so3_exp(np.array([0.05, -0.03, 0.02])) @ at.rotations[1], at.translations_mm[1] + [3.0, -2.0, 9.0]
    (ours, cost), (theirs, least) = (
        descend(*arguments, View(camera.as_array(), *start), 40, known_cost=0.0, share=0.0, least=1e-12)
        for camera in (RATIONAL, BROWN)
    )
    assert cost == pytest.approx(least, rel=1e-9)
    np.testing.assert_allclose(ours.rotation, theirs.rotation, atol=1e-8)
    np.testing.assert_allclose(ours.translation_mm, theirs.translation_mm, atol=1e-4)


@pytest.mark.parametrize("camera", [ANGULAR, RATIONAL])
def test_derivatives_of_the_priors_are_those_of_differences(camera: AnyCamera) -> None:
    parameters = camera.as_array()
    prior = wide_lens_prior((2448, 2050), (7.6, 0.6), len(parameters))
    _, Q = prior(parameters)
    for i in range(len(parameters)):
        h = 1e-6 * max(1.0, abs(parameters[i]))
        step = h * np.eye(len(parameters))[i]
        difference = (prior(parameters - step)[0] - prior(parameters + step)[0]) / (2.0 * h)
        np.testing.assert_allclose(Q[:, i], difference, rtol=1e-5, atol=1e-6)
