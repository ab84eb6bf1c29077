"""Cameras in the parameters of other lens models: exact where they can be, else off by what is stated."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry import (
    Camera,
    KannalaBrandtCamera,
    RationalCamera,
    convert_camera,
    fold_radius_px,
    project_any,
    undistort_any,
)

SIZE = (1280, 960)
BROWN = Camera(900.0, 901.0, 650.0, 470.0, -0.2, 0.08, 3e-4, -2e-4)
ANGULAR = KannalaBrandtCamera(560.0, 561.0, 645.0, 490.0, 0.08, -0.01, 0.002, 0.0, 2e-4, -1e-4)
FISHEYE = KannalaBrandtCamera(330.0, 330.0, 640.0, 480.0, -0.02, 0.002)


def largest(one: object, other: object, radius: float) -> float:
    """The largest distance at random pixels within a radius, by directions of the first camera."""
    rng = np.random.default_rng(0)
    angle, r = rng.uniform(0.0, 2.0 * math.pi, 4000), radius * np.sqrt(rng.uniform(0.0, 1.0, 4000))
    pixels = np.column_stack([one.cx_px + r * np.cos(angle), one.cy_px + r * np.sin(angle)])  # type: ignore[attr-defined]
    pixels = pixels[np.all((pixels > 0) & (pixels < np.array(SIZE) - 1), axis=1)]
    normalised = undistort_any(pixels, one)  # type: ignore[arg-type]
    back = project_any(np.column_stack([normalised, np.ones(len(normalised))]), other)  # type: ignore[arg-type]
    return float(np.max(np.linalg.norm(back - pixels, axis=1)))


def test_a_model_that_holds_the_other_takes_it_whole() -> None:
    same = convert_camera(BROWN, "brown", SIZE, 700.0)
    assert (same.camera, same.largest_error_px) == (BROWN, 0.0)
    wider = convert_camera(BROWN, "rational", SIZE, 700.0)
    assert isinstance(wider.camera, RationalCamera)
    assert largest(BROWN, wider.camera, 700.0) < 1e-6
    without = convert_camera(Camera(900.0, 900.0, 640.0, 480.0, -0.2), "brown", SIZE, 700.0, ("k3",))
    assert without.largest_error_px == 0.0


@pytest.mark.parametrize("model", ["rational", "brown"])
@pytest.mark.parametrize("camera", [BROWN, ANGULAR])
def test_the_error_stated_is_the_error_made(camera: object, model: str) -> None:
    found = convert_camera(camera, model, SIZE, 620.0)  # type: ignore[arg-type]
    made = largest(camera, found.camera, 620.0)
    assert made <= 1.05 * found.largest_error_px + 1e-6


def test_a_wide_lens_is_rational_to_a_fifth_of_a_pixel() -> None:
    assert convert_camera(ANGULAR, "rational", SIZE, 700.0).largest_error_px < 0.2


def test_a_lens_without_tangential_terms_takes_them_up_elsewhere() -> None:
    found = convert_camera(ANGULAR, "kannala_brandt", SIZE, 700.0, ("p1", "p2"))
    assert isinstance(found.camera, KannalaBrandtCamera)
    assert found.camera.p1 == found.camera.p2 == 0.0
    assert 0.0 < found.largest_error_px < 0.5
    assert largest(ANGULAR, found.camera, 700.0) <= 1.05 * found.largest_error_px


def test_a_fisheye_has_no_likeness_in_brown() -> None:
    assert convert_camera(FISHEYE, "brown", SIZE, 640.0).largest_error_px > 0.5


def test_nothing_is_compared_beyond_the_fold() -> None:
    folding = Camera(700.0, 700.0, 640.0, 480.0, -0.35)
    fold = fold_radius_px(folding)
    assert fold is not None
    assert convert_camera(folding, "rational", SIZE, 2.0 * fold).radius_px == pytest.approx(0.98 * fold)
    at = np.array([[640.0 + 0.9 * fold, 480.0], [640.0 + 0.99 * fold, 480.0], [640.0 + 1.1 * fold, 480.0]])
    assert np.isfinite(undistort_any(at, folding)).all(axis=1).tolist() == [True, False, False]
