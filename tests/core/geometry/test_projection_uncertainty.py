"""The uncertainty of projections: rotations do not count; sampled cameras, each turned to fit, scatter as stated."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float

from core.geometry import (
    LENS_PARAMETERS,
    AnyCamera,
    Camera,
    KannalaBrandtCamera,
    RationalCamera,
    camera_from_array,
    project_any,
    project_any_with_jacobian,
    projection_covariance,
    so3_exp,
    undistort_any,
    worst_direction,
)
from core.geometry.se3 import hats

CAMERAS: list[AnyCamera] = [
    Camera(900.0, 901.0, 650.0, 470.0, -0.2, 0.08, 3e-4, -2e-4),
    KannalaBrandtCamera(560.0, 561.0, 645.0, 490.0, 0.08, -0.01, 0.002, 0.0, 2e-4, -1e-4),
    RationalCamera(900.0, 901.0, 650.0, 470.0, -0.2, 0.08, 3e-4, -2e-4, 0.0, 0.01),
]
IDS = ["brown", "kannala_brandt", "rational"]
PIXELS = np.stack(np.meshgrid(np.linspace(0, 1279, 9), np.linspace(0, 959, 7)), axis=-1).reshape(-1, 2)
OBSERVED = PIXELS[(PIXELS[:, 0] > 200) & (PIXELS[:, 1] < 800)]
SIGMA = {"fx_px": 0.4, "fy_px": 0.4, "cx_px": 0.5, "cy_px": 0.5, "p1": 1e-5, "p2": 1e-5}
SAMPLES = 400


def uncertain(camera: AnyCamera) -> Float[np.ndarray, "s s"]:
    """A covariance with correlations, of sizes that calibrations have."""
    names = LENS_PARAMETERS[{9: "brown", 10: "kannala_brandt", 12: "rational"}[len(camera.as_array())]]
    sigma = np.array([SIGMA.get(name, 2e-4) for name in names])
    root = np.random.default_rng(5).standard_normal((len(names), len(names))) / np.sqrt(len(names))
    return np.asarray(sigma[:, None] * (root @ root.T) * sigma)


def turned_to_fit(
    directions: Float[np.ndarray, "n 3"],
    other: AnyCamera,
    observed: Float[np.ndarray, "m 3"],
    observed_px: Float[np.ndarray, "m 2"],
) -> Float[np.ndarray, "n 2"]:
    """Project with another camera, turned by Gauss and Newton until it sees the observed directions where they were."""
    R = np.eye(3)
    for _ in range(4):
        seen = observed @ R.T
        pixels, _, by_point = project_any_with_jacobian(seen, other)
        J = -np.transpose(by_point, (2, 1, 0)) @ hats(seen)
        w, *_ = np.linalg.lstsq(J.reshape(-1, 3), (observed_px - pixels.T).ravel())
        R = so3_exp(w) @ R
    return project_any(directions @ R.T, other)


@pytest.mark.parametrize("camera", CAMERAS, ids=IDS)
def test_samples_of_the_camera_scatter_as_stated(camera: AnyCamera) -> None:
    covariance = uncertain(camera)
    stated = projection_covariance(PIXELS, camera, covariance, OBSERVED, np.ones(len(OBSERVED)))
    directions = np.column_stack([undistort_any(PIXELS, camera), np.ones(len(PIXELS))])
    observed = np.column_stack([undistort_any(OBSERVED, camera), np.ones(len(OBSERVED))])
    drawn = np.random.default_rng(1).multivariate_normal(camera.as_array(), covariance, SAMPLES)
    shifts = (
        np.stack([turned_to_fit(directions, camera_from_array(one), observed, OBSERVED) for one in drawn])
        - PIXELS
    )
    found = np.einsum("kni,knj->nij", shifts, shifts) / SAMPLES
    # A variance of N samples has a relative standard deviation of √(2/N); pixels share the samples.
    ratio = np.trace(found, axis1=1, axis2=2) / np.trace(stated, axis1=1, axis2=2)
    assert np.all(np.abs(ratio - 1.0) < 5.0 * np.sqrt(2.0 / SAMPLES))
    assert np.all(
        np.abs(worst_direction(found) / worst_direction(stated) - 1.0) < 2.5 * np.sqrt(2.0 / SAMPLES)
    )


def test_a_principal_point_that_a_rotation_takes_up_is_almost_certain() -> None:
    """Of a long lens u(cx) = 1 px is a rotation of 1/f, and what remains of it is of the order of the field squared."""
    camera = Camera(20000.0, 20000.0, 639.5, 479.5)
    covariance = np.zeros((9, 9))
    covariance[2, 2] = 1.0
    found = worst_direction(projection_covariance(PIXELS, camera, covariance, PIXELS, np.ones(len(PIXELS))))
    assert found.max() < 2.0 * (800.0 / 20000.0) ** 2
    assert found.max() > 0.0


def test_pixels_beyond_the_fold_have_no_uncertainty_and_weigh_nothing() -> None:
    folding = Camera(600.0, 600.0, 639.5, 479.5, -0.45)
    covariance = uncertain(folding)
    found = projection_covariance(PIXELS, folding, covariance, PIXELS, np.ones(len(PIXELS)))
    known = np.isfinite(undistort_any(PIXELS, folding)).all(axis=1)
    assert 0 < np.count_nonzero(known) < len(PIXELS)
    assert np.array_equal(np.isfinite(worst_direction(found)), known)
    inside = PIXELS[known]
    alone = projection_covariance(inside, folding, covariance, inside, np.ones(len(inside)))
    assert found[known] == pytest.approx(alone)


def test_the_worst_direction_is_the_larger_eigenvalue() -> None:
    roots = np.random.default_rng(2).standard_normal((20, 2, 2))
    covariance = roots @ np.swapaxes(roots, 1, 2)
    assert worst_direction(covariance) == pytest.approx(np.sqrt(np.linalg.eigvalsh(covariance)[:, 1]))
