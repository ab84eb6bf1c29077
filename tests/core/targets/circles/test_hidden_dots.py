"""What hides dots, and what outshines them: they cost points, and neither names nor accuracy."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.errors import TargetNotFound
from core.simulation import Light, Scene
from core.targets import GridPoints, TargetSpec, detect
from tests.support.simulation.renders import render
from tests.support.targets.dot_scenes import scene_of


@pytest.mark.parametrize("kind", ["circles", "asymmetric_circles"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_what_hides_a_third_of_the_dots_costs_points_and_no_names(kind: str, seed: int) -> None:
    """A cable from end to end, a hand from one corner, a lamp's reflection: the others are right, as they say."""
    target = TargetSpec(kind, 12, 9, 25.0) if kind == "circles" else TargetSpec(kind, 6, 15, 18.0)
    scene = replace(scene_of(target, 10.0 + 8.0 * seed, seed, roll=0.5), noise_levels=2.0)
    clear = render(scene)
    corners = scene.points_px.reshape(target.rows, target.columns, 2)[[0, 0, -1, -1], [0, -1, -1, 0]]
    middle = corners.mean(axis=0)

    def cable(image: np.ndarray) -> None:
        a, b = (corners[k] + 0.43 * (corners[k + 1] - corners[k]) for k in (0, 2))
        ends = [tuple(np.rint(end + 0.2 * (end - middle)).astype(int).tolist()) for end in (a, b)]
        cv2.line(image, ends[0], ends[1], 90, 45)

    def hand(image: np.ndarray) -> None:
        outline = [
            corners[0] + share * (corners[k] - corners[0]) for k, share in ((1, 0.4), (2, 0.6), (3, 0.4))
        ]
        outline.append(corners[0] - 0.4 * (middle - corners[0]))
        cv2.fillPoly(image, [np.rint(outline).astype(np.int32)], 130)

    def reflection(image: np.ndarray) -> None:
        """Of a lamp: it blinds some of the dots, and ends within a few px."""
        lamp = np.zeros(image.shape, dtype=np.float32)
        axes = tuple((0.22 * np.linalg.norm(corners[[1, 3]] - corners[0], axis=1)).astype(int).tolist())
        cv2.ellipse(
            lamp,
            (tuple(middle.tolist()), (2 * axes[0], 2 * axes[1]), float(np.degrees(0.3))),
            500.0,
            cv2.FILLED,
        )
        image[:] = np.clip(image + cv2.GaussianBlur(lamp, (0, 0), 4.0), 0, 255).astype(np.uint8)

    for hide in (cable, hand, reflection):
        image = clear.copy()
        hide(image)
        found = detect(image, target)
        assert target.size / 2 <= len(found) < target.size, hide.__name__
        truth = scene.points_px.reshape(target.rows, target.columns, 2)
        names = [(found.row, found.column)]
        if found.labelling == "up_to_symmetry":
            names.append((target.rows - 1 - found.row, target.columns - 1 - found.column))
        off = min(
            (np.linalg.norm(found.points_px - truth[name], axis=1) for name in names), key=lambda o: o.max()
        )
        assert np.median(off) < 0.03, hide.__name__
        assert np.all(off < 8.0 * found.standard_uncertainty_px), hide.__name__


def _off(scene: Scene, found: GridPoints) -> np.ndarray:
    """How far the dots are from the truth, in the better of the orders that are left open."""
    target = scene.target
    truth = scene.points_px.reshape(target.rows, target.columns, 2)
    names = [(found.row, found.column)]
    if found.labelling == "up_to_symmetry":
        names.append((target.rows - 1 - found.row, target.columns - 1 - found.column))
    return min(
        (np.linalg.norm(found.points_px - truth[n], axis=1) for n in names), key=lambda o: np.median(o)
    )


_HIGHLIT = {
    "circles": TargetSpec("circles", 12, 9, 25.0),
    "asymmetric_circles": TargetSpec("asymmetric_circles", 6, 15, 18.0),
}


@pytest.mark.parametrize("kind", _HIGHLIT)
@pytest.mark.parametrize(
    ("bits", "seeds"),
    [(8, (6,)), *(pytest.param(bits, (4, 6, 7, 8, 11, 12), marks=pytest.mark.slow) for bits in (8, 12, 16))],
)
def test_a_wide_soft_reflection_costs_points_and_moves_none(
    kind: str, bits: int, seeds: tuple[int, ...]
) -> None:
    """Of a window: it fades over a fifth of the board. Dots in the white it saturates would be some .3 px off."""
    target, measured = _HIGHLIT[kind], 0
    for seed in seeds:
        light = Light(black_level=200.0, white_level=40.0) if seed == 4 else Light(gradient=(0.15, -0.1))
        scene = replace(
            scene_of(target, 8.0 * seed % 45.0, seed, roll=0.5),
            noise_levels=2.0,
            light=light,
            bit_depth=8 if bits == 8 else 16,
        )
        clear = render(scene)
        full = 255.0 if bits == 8 else 65535.0
        rng = np.random.default_rng([seed, 7])
        diagonal = float(np.linalg.norm(np.ptp(scene.points_px, axis=0)))
        lamp = scene.points_px[rng.integers(target.size)]
        sizes, peak = rng.uniform(0.1, 0.2, 2) * diagonal, rng.uniform(300.0, 700.0) * full / 255.0
        fades = [
            np.exp(-0.5 * ((np.arange(n) - middle) / size) ** 2)
            for n, middle, size in zip(clear.shape[::-1], lamp, sizes, strict=True)
        ]
        image = np.clip(clear + peak * np.outer(fades[1], fades[0]), 0, full).astype(clear.dtype)
        if bits == 12:
            image = image >> 4
        try:
            found = detect(image, target)
        except TargetNotFound:  # too much of it is blinded
            continue
        measured += 1
        assert len(found) < target.size
        assert "points_missing" in [w.code for w in found.warnings]
        assert np.all(_off(scene, found) < 6.0 * found.standard_uncertainty_px), seed
    assert measured >= len(seeds) / 2


@pytest.mark.parametrize("kind", _HIGHLIT)
@pytest.mark.parametrize(
    "exposure", [pytest.param(1.25, marks=pytest.mark.slow), 1.6, pytest.param(2.2, marks=pytest.mark.slow)]
)
def test_a_board_that_is_overexposed_evenly_is_measured(kind: str, exposure: float) -> None:
    target, usual = _HIGHLIT[kind], Light()
    light = Light(black_level=exposure * usual.black_level, white_level=exposure * usual.white_level)
    for seed in range(3):
        scene = replace(scene_of(target, 12.0 * seed, seed, roll=0.5), noise_levels=2.0, light=light)
        image = render(scene)
        assert (image == 255).mean() > 0.05
        found = detect(image, target)
        assert len(found) >= 0.8 * target.size
        assert np.all(_off(scene, found) < 6.0 * found.standard_uncertainty_px)
