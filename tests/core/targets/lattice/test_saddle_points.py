"""Saddle points and the rings about them, against plain numpy."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from core.targets.lattice.pyramid import Level, levels
from core.targets.lattice.rings import rings
from core.targets.lattice.saddle_points import find_saddles, saddle_points
from tests.support.targets.drawn_boards import board


def noisy_image() -> np.ndarray:
    """A board, tilted by a shear, with noise, blobs and bars around it."""
    image, _ = board(7, 5)
    shear = np.array([[0.9, 0.35, 10.0], [-0.2, 0.7, 60.0]])
    image = cv2.warpAffine(image, shear, (300, 260), borderValue=120.0)
    cv2.circle(image, (250, 40), 9, 10, -1, cv2.LINE_AA)
    cv2.line(image, (10, 230), (280, 250), 30, 3, cv2.LINE_AA)
    noise = np.random.default_rng(5).normal(0.0, 3.0, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(900, 1400), (901, 1403), (2500, 3001)])
def test_levels_keep_their_place(dtype: type, shape: tuple[int, int]) -> None:
    """The centre of gravity of a bright block is at the same place of the full image on every level."""
    image = np.zeros(shape, dtype=dtype)
    image[400:464, 640:736] = 200
    found = list(levels(image))
    assert [level.halvings for level in found] == sorted((level.halvings for level in found), reverse=True)
    assert max(found[0].image.shape) <= 700
    assert found[-1].halvings == (0 if image.size < 1_600_000 else 1)
    for level in found:
        v, u = np.nonzero(level.image == 200)
        middle = level.to_full(np.array([[u.mean(), v.mean()]]))
        np.testing.assert_allclose(middle, [[687.5, 431.5]], atol=1e-9)


def test_saddle_points_are_those_of_the_plain_formula() -> None:
    smooth = cv2.sepFilter2D(noisy_image(), cv2.CV_16S, np.float32([1, 2, 1]), np.float32([1, 2, 1]))
    f = smooth.astype(np.float32)  # as precise as the kernel: of nearly equal values the same one is larger
    xx, yy, xy = np.zeros_like(f), np.zeros_like(f), np.zeros_like(f)
    xx[:, 2:-2] = f[:, 4:] - 2.0 * f[:, 2:-2] + f[:, :-4]
    yy[2:-2] = f[4:] - 2.0 * f[2:-2] + f[:-4]
    xy[1:-1, 1:-1] = f[2:, 2:] - f[2:, :-2] - f[:-2, 2:] + f[:-2, :-2]
    saddle = xy**2 - xx * yy
    saddle[saddle <= np.float32(0.3) * (xx + yy) ** 2] = 0.0
    saddle[:2], saddle[-2:], saddle[:, :2], saddle[:, -2:] = 0.0, 0.0, 0.0, 0.0
    largest = saddle == cv2.dilate(saddle, np.ones((5, 5)))
    expected = []
    for v, u in np.argwhere(largest & (saddle > 2000.0)):
        if not (5 <= v < f.shape[0] - 5 and 5 <= u < f.shape[1] - 5):
            continue
        if np.any(
            saddle[v - 2 : v + 3, u - 2 : u + 3].ravel()[:12] == saddle[v, u]
        ):  # an earlier one is as large
            continue
        part = f[v - 1 : v + 2, u - 1 : u + 2].astype(np.float64)
        g = np.array([part[1, 2] - part[1, 0], part[2, 1] - part[0, 1]]) / 2.0
        mixed = (part[2, 2] - part[2, 0] - part[0, 2] + part[0, 0]) / 4.0
        H = np.array(
            [
                [part[1, 2] - 2 * part[1, 1] + part[1, 0], mixed],
                [mixed, part[2, 1] - 2 * part[1, 1] + part[0, 1]],
            ]
        )
        if np.linalg.det(H) >= 0.0:
            continue
        shift = -np.linalg.solve(H, g)
        if np.abs(shift).max() <= 1.3:
            expected.append([u + shift[0], v + shift[1], f[v, u] + 0.5 * g @ shift])
    places = np.empty((5000, 3), dtype=np.float32)
    count = saddle_points(smooth, np.float32(2000.0), places)
    assert count > 35
    np.testing.assert_allclose(places[:count], np.array(expected), rtol=1e-4, atol=1e-3)
    few = np.empty((3, 3), dtype=np.float32)
    assert saddle_points(smooth, np.float32(2000.0), few) == count
    np.testing.assert_array_equal(few, places[:3])


def plain_ring(
    smooth: np.ndarray, place: np.ndarray, radius: float, least: float, *, centred: bool = False
) -> tuple[np.ndarray, float] | None:
    """The ring test of one place in plain numpy: directions of the four edges and contrast."""
    angle = 2.0 * np.pi * np.arange(32) / 32
    u, v = place[0] + radius * np.cos(angle), place[1] + radius * np.sin(angle)
    values = cv2.remap(
        smooth.astype(np.float32), u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR
    )
    ring = values.ravel() - place[2]
    if centred:
        ring = ring - 0.5 * (ring.min() + ring.max())
    changes = np.flatnonzero((ring >= 0) != (np.roll(ring, 1) >= 0))
    if len(changes) != 4:
        return None
    start = max(i for i in range(4) if ring[changes[i]] >= 0)
    changes = np.roll(changes, -start)
    sectors = [
        np.abs(np.take(ring, range(a, b if b > a else b + 32), mode="wrap")).max()
        for a, b in zip(changes, np.roll(changes, -1), strict=True)
    ]
    if min(sectors) < least or min(sectors) < 0.2 * max(sectors):
        return None
    at = changes - ring[changes] / (ring[changes] - ring[changes - 1])
    at = np.where(at < at[0], at + 32, at) * 2.0 * np.pi / 32
    if max(abs(at[2] - at[0] - np.pi), abs(at[3] - at[1] - np.pi)) > 0.7:
        return None
    return at, 0.5 * sum(sectors)


def plain_rings(smooth: np.ndarray, place: np.ndarray, *, centred: bool) -> tuple[np.ndarray, float] | None:
    """The largest ring that still agrees with the smaller ones, in plain numpy."""
    kept = None
    for radius in (2.0, 3.5, 5.0):
        result = plain_ring(smooth, place, radius, 20.0, centred=centred)
        if kept is not None:
            if result is None:
                break
            difference = np.abs(result[0][:2] - kept[0][:2]) % np.pi
            if np.minimum(difference, np.pi - difference).max() > 0.45:
                break
        kept = result
    return kept


def test_rings_are_those_of_the_plain_test() -> None:
    smooth = cv2.sepFilter2D(noisy_image(), cv2.CV_16S, np.float32([1, 2, 1]), np.float32([1, 2, 1]))
    places = np.empty((5000, 3), dtype=np.float32)
    places = places[: saddle_points(smooth, np.float32(500.0), places)]
    angle = 2.0 * np.pi * np.arange(32) / 32
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
    points, rays, contrast = rings(smooth, places, circle, 20.0)
    expected = []
    for place in places:
        if not (6 <= place[0] < smooth.shape[1] - 7 and 6 <= place[1] < smooth.shape[0] - 7):
            continue
        kept = plain_rings(smooth, place, centred=False) or plain_rings(smooth, place, centred=True)
        if kept is not None:
            expected.append((place[:2], *kept))
    assert 35 <= len(expected) < len(places)
    np.testing.assert_array_equal(points, [e[0] for e in expected])
    directions = np.array([e[1] for e in expected])
    np.testing.assert_allclose(rays, np.stack([np.cos(directions), np.sin(directions)], axis=2), atol=5e-3)
    np.testing.assert_allclose(contrast, [e[2] for e in expected], rtol=1e-3)


def test_rays_run_along_the_edges_with_bright_after_the_first() -> None:
    image, grid = board(6, 5)
    saddles = find_saddles(Level(image, 0))
    assert len(saddles) == 30
    for point, rays in zip(saddles.points, saddles.rays, strict=True):
        distance = np.linalg.norm(grid - point, axis=2)
        j, i = np.unravel_index(np.argmin(distance), distance.shape)
        assert distance[j, i] < 0.6  # between pixels, so the quadratic through 3 x 3 of them is not centred
        # square (j, i), right of and below the point, is black where i + j is even
        first = np.array([0.0, 1.0]) if (i + j) % 2 == 0 else np.array([1.0, 0.0])
        assert np.abs(rays[[0, 2]] @ first).min() > 0.99
        assert np.abs(rays[[1, 3]] @ first).max() < 0.1
