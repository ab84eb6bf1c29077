"""ChArUco boards whose squares measure 10 to 20 px: found as far as the blur leaves their markers' cells distinct."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.errors import TargetNotFound
from core.geometry import unit_square_homography
from core.simulation import Scene
from core.targets import detect
from core.targets.charuco import charuco_layout
from core.targets.lattice.lattice import Lattice
from core.targets.markers import decode_small_markers, marker_codes, nearest_markers
from core.targets.markers.small_markers import area_weights
from core.targets.specification import TargetSpec
from core.targets.subpixel.corner_model import marker_profile, normal_step
from tests.support.image.tilted_sheets import CAMERA, errors, take, tilted_scene, truth_px
from tests.support.simulation.renders import render

PITCH_MM = 22.0


def board(bits: int, ratio: float = 0.75) -> TargetSpec:
    return TargetSpec("charuco", 9, 6, PITCH_MM, ratio * PITCH_MM, f"DICT_{bits}X{bits}_100")


def small(target: TargetSpec, square_px: float, seed: int = 2, **how: float) -> tuple[Scene, np.ndarray]:
    """The board with squares of some px where it is not foreshortened, any way up."""
    rng = np.random.default_rng(seed)
    how = {"blur_px": 0.5, "noise_levels": 2.0, "tilt_deg": float(rng.uniform(0.0, 40.0))} | how
    turn, offset_mm = float(rng.uniform(-3.0, 3.0)), float(rng.uniform(-200.0, 200.0))
    depth_mm = CAMERA.fx_px * PITCH_MM / square_px
    scene = tilted_scene(target, turn=turn, offset_mm=offset_mm, depth_mm=depth_mm, **how)
    scene = dataclasses.replace(scene, seed=seed, background_seed=seed)
    return scene, render(scene)


@pytest.mark.parametrize(("bits", "square_px"), [(4, 10.0), (5, 12.0), (6, 15.0)])
def test_small_squares_are_found(bits: int, square_px: float) -> None:
    count, rms, stated = errors(*small(board(bits), square_px))
    assert count >= 50
    assert rms < 0.02
    assert 0.7 < stated < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("bits", [4, 5, 6])
def test_small_squares_are_found_or_refused_but_never_misplaced(bits: int) -> None:
    """Of sharp ones from 11 px on nearly all are found; blurred ones may be refused."""
    found = sharp = 0
    for seed in range(5):
        for square_px in (11.0, 13.0, 15.0):
            for blur_px, noise in ((0.5, 2.0), (0.7, 4.0), (1.0, 4.0)):
                scene, image = small(board(bits), square_px, seed, blur_px=blur_px, noise_levels=noise)
                try:
                    points = detect(image, scene.target)
                except TargetNotFound:
                    is_found = False
                else:
                    is_found = True
                    assert np.abs(points.points_px - truth_px(scene, points)).max() < 0.5
                if blur_px < 1.0:
                    found, sharp = found + is_found, sharp + 1
    assert found >= 0.9 * sharp


def test_squares_too_small_to_read_are_refused_as_such() -> None:
    scene, image = small(board(6), 11.0, blur_px=1.2, noise_levels=5.0, tilt_deg=10.0)
    with pytest.raises(TargetNotFound, match=r"squares are only 1[01] px wide") as refused:
        detect(image, scene.target)
    assert "nearer" in refused.value.advice
    assert "larger squares" in refused.value.advice


def test_no_markers_are_read_on_other_boards() -> None:
    """Neither are those of another dictionary, nor any on a chessboard."""
    _, image = small(board(5), 12.0)
    with pytest.raises(TargetNotFound):
        detect(image, board(4))
    with pytest.raises(TargetNotFound):
        detect(small(TargetSpec("chessboard", 9, 6, PITCH_MM), 12.0)[1], board(4))


def test_cells_of_a_pixel_are_read() -> None:
    """Where the corners are known to a tenth of a px, nearly all markers; none is taken for another."""
    target = board(6)
    scene, image = small(target, 11.0, tilt_deg=15.0)
    codes = marker_codes(str(target.dictionary))
    grid = scene.points_px + np.random.default_rng(1).normal(0.0, 0.1, scene.points_px.shape)
    grid = grid.reshape(target.rows, target.columns, 2)
    gap = np.full(grid.shape[:2], 130.0)
    lattice = Lattice(grid, gap, np.zeros(gap.shape, np.bool_), False)
    for view in (image, image.astype(np.uint16) * 257):
        scaled = dataclasses.replace(lattice, gap=gap * (257.0 if view.dtype == np.uint16 else 1.0))
        seen, printed = decode_small_markers(view, scaled, codes.side, 0.75)
        nearest = nearest_markers(seen.codes, codes.codes, codes.max_hamming)
        own = charuco_layout(target).marker_squares
        read = [
            (k, tuple(p)) for (k, *_), p in zip(nearest, (seen.place + 1).tolist(), strict=True) if k >= 0
        ]
        assert len(read) >= 27
        assert printed >= len(read)
        assert all(tuple(own[k]) == place for k, place in read)
    plain = np.full_like(image, 200)
    seen, printed = decode_small_markers(plain, lattice, codes.side, 0.75)
    assert len(seen.codes) == printed == 0


def test_area_weights_are_those_of_blurred_areas() -> None:
    """Against each area drawn twenty times as fine, then blurred: within some hundredths of a pixel's grey."""
    edges = np.array([-0.2, 0.0, 0.3, 0.7, 1.0, 1.2])
    areas = np.arange(25).reshape(5, 5)
    quad = np.array([[3.3, 2.8], [12.9, 4.1], [13.6, 13.2], [2.1, 12.4]])
    H = np.empty(8)
    assert unit_square_homography(quad[0], quad[1], quad[2], quad[3], H)
    sigma, fine = 0.8, 20
    W = area_weights(H, 10.0, 10.0, edges, areas, 25, sigma, 0, 0, 16, 16)
    back = np.linalg.inv(np.append(H, 1.0).reshape(3, 3))
    at = (np.arange(16 * fine) + 0.5) / fine - 0.5
    u, v = np.meshgrid(at, at)
    x, y, w = np.moveaxis(np.stack([u, v, np.ones_like(u)], axis=2) @ back.T, 2, 0)
    inside = [np.searchsorted(edges, a / w) - 1 for a in (x, y)]
    kernel = np.exp(-0.5 * ((at[None] - np.arange(16)[:, None]) / sigma) ** 2)
    kernel /= sigma * np.sqrt(2.0 * np.pi) * fine
    for area in (6, 12, 13, 18):
        drawn = (inside[0] == area % 5) & (inside[1] == area // 5)
        expected = kernel @ drawn @ kernel.T
        np.testing.assert_allclose(W[area].reshape(16, 16), expected, atol=0.02)


def test_the_markers_profile_has_its_own_derivatives() -> None:
    arguments = (0.9, 1.4, -1.0, 1.8, 1.5, 2.1, 1.7)
    a, o, sign, margin, border, margin_o, border_o = arguments
    value, by_a, by_o, by_wider, by_wider_o = marker_profile(*arguments)

    def inside(x: float) -> float:
        return 0.5 + 0.5 * normal_step(x)[0]

    expected = 0.0
    for side in (1.0, -1.0):
        x, y = side * a - margin, sign * side * o - margin_o
        expected -= 2.0 * inside(x) * inside(y) - inside(x - border) * inside(y - border_o)
    assert value == pytest.approx(expected, abs=1e-12)
    h, e = 1e-4, 1.0 + 1e-4

    def difference(*upper_and_lower: tuple[float, ...]) -> float:
        upper, lower = (marker_profile(*some)[0] for some in upper_and_lower)
        return upper - lower

    rest = (sign, margin, border, margin_o, border_o)
    assert by_a == pytest.approx(difference((a + h, o, *rest), (a - h, o, *rest)) / (2 * h), abs=2e-3)
    assert by_o == pytest.approx(difference((a, o + h, *rest), (a, o - h, *rest)) / (2 * h), abs=2e-3)
    wider = difference(
        (a / e, o, sign, margin / e, border / e, margin_o, border_o),
        (a * e, o, sign, margin * e, border * e, margin_o, border_o),
    )
    assert by_wider == pytest.approx(wider / (2 * h), abs=2e-3)
    wider = difference(
        (a, o / e, sign, margin, border, margin_o / e, border_o / e),
        (a, o * e, sign, margin, border, margin_o * e, border_o * e),
    )
    assert by_wider_o == pytest.approx(wider / (2 * h), abs=2e-3)


def test_a_sharp_image_of_a_board_seen_by_markers_alone_is_refined() -> None:
    """The markers' edges are part of the corners' model: blur and contrast are those of the squares' edges."""
    scene, image = take(board(4), depth_mm=CAMERA.fx_px * PITCH_MM / 16.0, blur_px=0.5, tilt_deg=10.0)
    count, rms, stated = errors(scene, image)
    assert count == 54
    assert rms < 0.012
    assert 0.7 < stated < 1.4
