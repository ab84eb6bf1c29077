"""The bound of corners, against the closed form of straight edges and against a shift by other means."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry.camera import Camera
from core.simulation import Light, Scene
from core.simulation.renderer import render_levels
from core.targets.specification import TargetSpec
from tests.support.cramer_rao import corner_bounds, sheet_derivative

SQUARE_PX, NOISE = 40.0, 4.0


def flat_scene(blur_px: float = 1.0, angle_deg: float = 12.0, **changes: object) -> Scene:
    """A board seen straight on, turned, without lens or uneven light."""
    target = TargetSpec("chessboard", 6, 5, pitch_mm=20.0)
    angle = math.radians(angle_deg)
    T = np.eye(4)
    T[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    T[:3, 3] = (*(-T[:2, :2] @ (50.0, 40.0)), 20.0 * 800.0 / SQUARE_PX)
    camera = Camera(800.0, 800.0, 200.0, 170.0)
    plain = {"width_px": 400, "height_px": 340, "noise_levels": NOISE, "blur_px": blur_px}
    return Scene(target, camera, T, **{**plain, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize("blur_px", [0.7, 1.0, 2.0])
@pytest.mark.parametrize("bit_depth", [8, 16])
def test_straight_edges_have_the_closed_form(blur_px: float, bit_depth: int) -> None:
    """An edge of length L, contrast C and blur s gives L C² / (2 √π s) / n² of where it is across."""
    scene = flat_scene(blur_px, bit_depth=bit_depth)
    bounds = corner_bounds(scene)
    s = math.sqrt(blur_px**2 + 1.0 / 12.0)
    rounding = (1.0 if bit_depth == 8 else 1.0 / 257.0) ** 2 / 12.0
    contrast = scene.light.white_level - scene.light.black_level
    # at the crossing the two edges blur each other: of each a length of 2 s / √π (1 - 1/√2) or so is lost
    information = SQUARE_PX * contrast**2 / (2.0 * math.sqrt(math.pi) * s) / (NOISE**2 + rounding)
    lost = 1.2 * s / SQUARE_PX
    expected = 1.0 / math.sqrt(information)
    assert np.all(bounds.standard_deviation_px > 0.99 * expected)
    assert np.all(bounds.standard_deviation_px < expected * (1.02 + lost))
    # perpendicular edges determine both directions equally
    covariance = bounds.covariance_px2
    np.testing.assert_allclose(covariance[:, 0, 1] / covariance[:, 0, 0], 0.0, atol=0.1)


def test_unknown_light_costs_something() -> None:
    bounds = corner_bounds(flat_scene())
    ratio = bounds.standard_deviation_light_free_px / bounds.standard_deviation_px
    # A slope along an edge looks like a shift of it. With T = sgn x sgn y over a square of side L: <∂T/∂x, y> = L²/2,
    # |∂T/∂x|² = 2 L / (√π s), and of |y|² = L⁴/12 the contrast's slope x T explains 9/16.
    share = (24.0 / 7.0) * math.sqrt(math.pi) * math.hypot(1.0, 12**-0.5) / SQUARE_PX
    expected = math.sqrt(1.0 / (1.0 - share))
    np.testing.assert_allclose(ratio, expected, rtol=0.02)


def test_noise_and_contrast_scale_it() -> None:
    one = corner_bounds(flat_scene()).standard_deviation_px
    noisy = corner_bounds(flat_scene(noise_levels=8.0)).standard_deviation_px
    faint = corner_bounds(flat_scene(light=Light(100.0, 187.5))).standard_deviation_px
    rounding = 1.0 / 12.0
    np.testing.assert_allclose(noisy / one, math.sqrt((64.0 + rounding) / (16.0 + rounding)), rtol=1e-6)
    np.testing.assert_allclose(faint / one, 2.0, rtol=1e-4)


def test_derivative_is_that_of_the_image_where_it_is_fine_enough() -> None:
    """On a well blurred image in even light it is that by fourth-order differences."""
    scene = flat_scene(blur_px=3.0)
    levels = render_levels(scene).astype(np.float64)
    inner = np.s_[100:240, 130:270]
    by_u = (8.0 * (levels[:, 3:-1] - levels[:, 1:-3]) - (levels[:, 4:] - levels[:, :-4])) / 12.0
    by_v = (8.0 * (levels[3:-1] - levels[1:-3]) - (levels[4:] - levels[:-4])) / 12.0
    for derivative, expected in (
        (sheet_derivative(scene, 1.0, 0.0)[inner], -np.pad(by_u, ((0, 0), (2, 2)))[inner]),
        (sheet_derivative(scene, 0.0, 1.0)[inner], -np.pad(by_v, ((2, 2), (0, 0)))[inner]),
    ):
        assert np.abs(derivative - expected).max() < 0.01 * np.abs(expected).max()


@pytest.mark.slow
def test_maximum_likelihood_reaches_it() -> None:
    """A fit of the shift of whole cells, by the exact derivatives, to many noisy images."""
    scene = flat_scene()
    levels = render_levels(scene).astype(np.float64)
    by = [sheet_derivative(scene, *d).astype(np.float64) for d in ((1.0, 0.0), (0.0, 1.0))]
    bounds = corner_bounds(scene)
    v, u = np.mgrid[0:340, 0:400]
    angle = math.radians(12.0)
    corner = scene.points_px[14]
    du, dv = u - corner[0], v - corner[1]
    along, across = du * math.cos(angle) + dv * math.sin(angle), dv * math.cos(angle) - du * math.sin(angle)
    cell = (np.abs(along) < SQUARE_PX / 2.0) & (np.abs(across) < SQUARE_PX / 2.0)
    J = np.stack([b[cell] for b in by], axis=1)
    rng = np.random.default_rng(0)
    estimates = []
    for _ in range(2000):
        noisy = np.rint(levels[cell] + NOISE * rng.standard_normal(int(cell.sum())))
        estimates.append(np.linalg.lstsq(J, noisy - levels[cell], rcond=None)[0])
    scatter = math.sqrt(np.mean(np.var(estimates, axis=0)))
    assert scatter == pytest.approx(bounds.standard_deviation_px[14], rel=0.05)
