"""Boards of dots: their centres against rendered truth, which dot is the origin, and what is not such a board."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from core.errors import OriginUnknown, TargetMirrored, TargetMismatch, TargetNotFound
from core.geometry.camera import Camera
from core.simulation import Light, Scene, standard_scene, standard_target
from core.simulation.scenes import random_pose
from core.targets import GridPoints, TargetSpec, detect
from core.targets.circles.blobs import Dots, patches
from core.targets.circles.ellipse_model import RESIDUAL, ROWS, TOGETHER, normal, write_equations
from core.targets.circles.ellipse_solver import fit_dot, fit_each, solve_equations
from core.targets.circles.lattice import crosses, dot_lattices
from core.targets.grid_index import cells_of, lines
from tests.support.image.dot_sites import sites_of
from tests.support.simulation.renders import render

CAMERA = Camera(1500.0, 1500.0, 795.0, 603.0, k1=-0.2)
SIZE = (1600, 1200)
SYMMETRIC = TargetSpec("circles", 9, 7, 25.0)
ASYMMETRIC = TargetSpec("asymmetric_circles", 4, 11, 20.0)


def scene_of(target: TargetSpec, tilt_deg: float, seed: int, *, roll: float = 0.6) -> Scene:
    T = random_pose(target, CAMERA, SIZE, math.radians(tilt_deg), roll, np.random.default_rng(seed))
    light = Light(gradient=(0.15, -0.1), vignetting=0.2)
    return Scene(target, CAMERA, T, *SIZE, light=light, clutter=0.7, seed=seed, background_seed=seed)


def errors(scene: Scene, found: object) -> np.ndarray:
    truth = scene.points_px.reshape(scene.target.rows, scene.target.columns, 2)
    return np.asarray(found.points_px - truth[found.row, found.column])  # type: ignore[attr-defined]


@pytest.mark.parametrize("target", [SYMMETRIC, ASYMMETRIC], ids=["circles", "asymmetric"])
@pytest.mark.parametrize("tilt_deg", [0.0, 25.0, 45.0])
def test_centres_are_those_of_the_dots_not_of_their_images(target: TargetSpec, tilt_deg: float) -> None:
    """Without noise, under perspective and a lens with k1 -.2. Left alone, the images' own centres are off by up to
    half a pixel."""
    scene = scene_of(target, tilt_deg, seed=1)
    found = detect(render(scene), target)
    assert len(found) >= target.size - 1
    error = errors(scene, found)
    assert np.abs(error).max() < 0.005
    assert np.abs(error.mean(axis=0)).max() < 0.001


@pytest.mark.parametrize("seed", range(3))
def test_errors_are_as_stated(seed: int) -> None:
    scene = replace(scene_of(SYMMETRIC, 15.0 * seed + 10.0, seed), noise_levels=4.0)
    found = detect(render(scene), SYMMETRIC)
    assert len(found) == SYMMETRIC.size
    z = errors(scene, found) / found.standard_uncertainty_px[:, None]
    # of 126 coordinates the rms scatters by 1 / sqrt(252) = .063
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.2)
    assert np.median(found.standard_uncertainty_px) < 0.02


@pytest.mark.parametrize("target", [SYMMETRIC, ASYMMETRIC], ids=["circles", "asymmetric"])
@pytest.mark.parametrize("threshold", [90, 130])
def test_thresholded_dots_are_uncertain_by_their_pixels(target: TargetSpec, threshold: int) -> None:
    z = []
    for seed in range(60, 64):
        scene = scene_of(target, 10.0 * (seed - 60) + 5.0, seed)
        image = np.where(render(replace(scene, noise_levels=2.0)) > threshold, 255, 0).astype(np.uint8)
        found = detect(image, target)
        assert len(found) >= 0.9 * target.size
        assert np.median(found.standard_uncertainty_px) > 0.02
        z.append(errors(scene, found) / found.standard_uncertainty_px[:, None])
    assert 0.5 < np.sqrt(np.mean(np.concatenate(z) ** 2)) < 1.2


def test_bright_dots_on_a_dark_sheet() -> None:
    scene = replace(
        scene_of(SYMMETRIC, 20.0, seed=4), light=Light(black_level=200.0, white_level=40.0), noise_levels=2.0
    )
    found = detect(render(scene), SYMMETRIC)
    assert len(found) == SYMMETRIC.size
    assert np.abs(errors(scene, found)).max() < 0.05


@pytest.mark.parametrize("turns", range(4))
def test_a_larger_dot_is_the_origin(turns: int) -> None:
    """Whichever way the camera is turned, and on a board with as many columns as rows."""
    target = TargetSpec("circles", 7, 7, 25.0)
    scene = replace(scene_of(target, 15.0, seed=2, roll=0.2), origin_dot=1.5, noise_levels=2.0)
    found = detect(np.ascontiguousarray(np.rot90(render(scene), turns)), target)
    assert not found.warnings
    truth = scene.points_px.reshape(7, 7, 2)[found.row, found.column]
    off = np.abs(unturned(found.points_px, turns) - truth)
    assert off.max() < 0.05


def unturned(points: np.ndarray, turns: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Pixels of an image that numpy turned by quarter turns, as pixels of the one before."""
    width, height = size
    u, v = points.T
    return {
        0: np.stack([u, v], axis=1),
        1: np.stack([width - 1.0 - v, u], axis=1),
        2: np.stack([width - 1.0 - u, height - 1.0 - v], axis=1),
        3: np.stack([v, height - 1.0 - u], axis=1),
    }[turns]


def test_boards_that_look_the_same_when_turned_are_said_to() -> None:
    for target, ambiguous in ((SYMMETRIC, True), (ASYMMETRIC, False), (replace(ASYMMETRIC, rows=10), True)):
        image = render(scene_of(target, 20.0, seed=3, roll=0.2))
        found = detect(image, target)
        assert [w.code for w in found.warnings] == (["board_symmetry_unresolved"] if ambiguous else [])


def test_an_asymmetric_board_upside_down_keeps_its_origin() -> None:
    scene = scene_of(ASYMMETRIC, 20.0, seed=5, roll=0.2)
    found = detect(np.ascontiguousarray(np.rot90(render(scene), 2)), ASYMMETRIC)
    truth = scene.points_px.reshape(11, 4, 2)[found.row, found.column]
    assert np.abs(unturned(found.points_px, 2) - truth).max() < 0.01


def test_covered_dots_are_missing_and_the_others_stay() -> None:
    scene = replace(scene_of(SYMMETRIC, 20.0, seed=6), noise_levels=2.0)
    image = render(scene)
    middle = scene.points_px.reshape(7, 9, 2)[3, 4]
    u, v = (round(float(c)) for c in middle)
    cv2.line(image, (u - 120, v - 100), (u + 120, v + 100), 90, 25)  # a cable
    found = detect(image, SYMMETRIC)
    assert 0.75 * SYMMETRIC.size <= len(found) < SYMMETRIC.size
    assert "points_missing" in [w.code for w in found.warnings]
    error = np.abs(errors(scene, found)).max(axis=1)
    assert np.quantile(error, 0.9) < 0.03
    assert np.all(error < 8.0 * found.standard_uncertainty_px)


def test_another_grid_is_named() -> None:
    image = render(replace(scene_of(SYMMETRIC, 10.0, seed=7), clutter=0.0))
    with pytest.raises(TargetMismatch, match="9 x 7 dots is in view, 8 x 5 was asked for"):
        detect(image, TargetSpec("circles", 8, 5, 25.0))
    with pytest.raises(TargetMismatch, match="9 x 7"):
        detect(image, TargetSpec("circles", 12, 9, 25.0))


WINDOWS = {
    "right": (-9.0, -9.0, 0.75, 9.0),
    "bottom": (-9.0, -9.0, 9.0, 0.75),
    "right and bottom": (-9.0, -9.0, 0.75, 0.75),
}


def cut(image: np.ndarray, scene: Scene, shares: tuple[float, ...]) -> tuple[np.ndarray, tuple[int, int]]:
    """A part of the image, its borders as shares of the grid points' bounding box; and where it begins."""
    low, high = scene.points_px.min(axis=0), scene.points_px.max(axis=0)
    edges = np.concatenate([low + shares[:2] * (high - low), low + shares[2:] * (high - low)])
    x0, y0, x1, y1 = (max(round(float(edge)), 0) for edge in edges)
    return np.ascontiguousarray(image[y0:y1, x0:x1]), (x0, y0)


@pytest.mark.parametrize("where", WINDOWS)
@pytest.mark.parametrize("is_bright", [False, True])
def test_a_part_with_the_larger_dot_is_named(where: str, is_bright: bool) -> None:
    light = Light(black_level=200.0, white_level=40.0) if is_bright else Light()
    for target in (SYMMETRIC, TargetSpec("circles", 8, 8, 25.0)):
        scene = replace(
            scene_of(target, 20.0, seed=8, roll=0.3), origin_dot=1.5, noise_levels=2.0, light=light
        )
        image, begin = cut(render(scene), scene, WINDOWS[where])
        found = detect(image, target)
        assert found.labelling == "absolute"
        assert [w.code for w in found.warnings] == ["points_missing"]
        assert 0.4 * target.size < len(found) < target.size
        truth = scene.points_px.reshape(target.rows, target.columns, 2)[found.row, found.column]
        off = np.abs(found.points_px + begin - truth).max(axis=1)
        assert np.median(off) < 0.02
        assert np.all(off < 6.0 * found.standard_uncertainty_px)  # some dots are cut in two


@pytest.mark.parametrize("where", WINDOWS)
def test_a_part_without_the_larger_dot_is_rejected(where: str) -> None:
    """Of staggered dots too, which have no larger one.

    Less is in view than of parts with a larger dot: at three quarters half of the outermost staggered line remains,
    which is enough for a whole board.
    """
    shares = tuple(0.7 if share == 0.75 else share for share in WINDOWS[where])
    for target in (SYMMETRIC, replace(ASYMMETRIC, columns=6)):
        scene = replace(scene_of(target, 20.0, seed=9, roll=1.5), noise_levels=2.0)
        image, _ = cut(render(scene), scene, shares)
        with pytest.raises(OriginUnknown):
            detect(image, target)


def test_staggered_places_are_where_the_dots_lie() -> None:
    for target in (SYMMETRIC, ASYMMETRIC, replace(ASYMMETRIC, rows=10)):
        row, column = (a.ravel() for a in np.mgrid[0 : target.rows, 0 : target.columns])
        sites = sites_of(target, column, row)
        np.testing.assert_allclose(sites * target.pitch_mm, target.points_target()[:, :2])
        assert tuple(sites.max(axis=0) + 1) == lines(target)
        np.testing.assert_array_equal(np.stack(cells_of(target, sites)), np.stack([column, row]))


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


def test_a_part_that_cannot_be_of_the_board_is_rejected() -> None:
    scene = replace(scene_of(SYMMETRIC, 15.0, seed=9, roll=0.2), noise_levels=2.0)
    image, _ = cut(render(scene), scene, WINDOWS["right"])  # seven dots from end to end
    for asked in ((9, 8), (12, 10), (6, 5)):
        with pytest.raises((TargetNotFound, TargetMismatch)):
            detect(image, TargetSpec("circles", *asked, 25.0))


def test_mirrored_prints_are_recognised_where_they_differ() -> None:
    """By the larger dot, and by the rows' order where there is an even number of staggered rows."""
    marked = replace(scene_of(SYMMETRIC, 15.0, seed=2), origin_dot=1.5, noise_levels=2.0)
    staggered = replace(scene_of(replace(ASYMMETRIC, rows=10), 20.0, seed=3), noise_levels=2.0)
    for scene in (marked, staggered):
        image = render(scene)
        assert detect(image, scene.target).labelling in ("absolute", "up_to_symmetry")
        with pytest.raises(TargetMirrored):
            detect(np.ascontiguousarray(image[:, ::-1]), scene.target)


@pytest.mark.parametrize("kind", ["circles", "asymmetric_circles"])
def test_boards_of_two_sizes_in_one_image_are_each_found(kind: str) -> None:
    sizes = ((9, 7), (7, 5)) if kind == "circles" else ((4, 11), (3, 9))
    scenes = [
        replace(scene_of(TargetSpec(kind, *size, 25.0), 20.0, seed, roll=0.3), noise_levels=2.0)
        for seed, size in enumerate(sizes)
    ]
    both = np.concatenate([render(scene) for scene in scenes], axis=1)
    for scene, shift in zip(scenes, (0.0, SIZE[0]), strict=True):
        found = detect(both, scene.target)
        assert len(found) == scene.target.size
        flipped = errors_either_way(scene, found)
        assert np.abs(flipped - np.array([shift, 0.0])).max() < 0.06
    twice = np.concatenate([render(scenes[0])] * 2, axis=1)
    with pytest.raises(TargetMismatch, match="2 grids"):
        detect(twice, scenes[0].target)


def errors_either_way(scene: Scene, found: GridPoints) -> np.ndarray:
    """The errors in the order that fits, of those in which the board looks the same."""
    turned = replace(
        found, column=scene.target.columns - 1 - found.column, row=scene.target.rows - 1 - found.row
    )
    return min(
        (errors(scene, each) for each in (found, turned)), key=lambda e: float(np.ptp(e, axis=0).max())
    )


def test_what_is_no_board_of_dots_is_rejected() -> None:
    chessboard = render(standard_scene(standard_target(9, 6), seed=1))
    noise = np.random.default_rng(0).integers(0, 256, (600, 800), dtype=np.uint8)
    for image in (chessboard, noise, np.full((600, 800), 128, np.uint8)):
        with pytest.raises((TargetNotFound, TargetMismatch)):  # what lies about may be a grid of its own
            detect(image, SYMMETRIC)


@pytest.mark.parametrize("turn_deg", [0.0, 20.0])
def test_a_grille_of_as_many_squares_is_no_board(turn_deg: float) -> None:
    """Though it has the size that is asked for; round dots at the same places are the board."""
    turn = cv2.getRotationMatrix2D((400.0, 300.0), turn_deg, 1.0)
    for is_round in (True, False):
        image = np.full((600, 800), 200, np.uint8)
        for row, column in np.ndindex(7, 9):
            u, v = 200 + 50 * column, 150 + 50 * row
            if is_round:
                cv2.circle(image, (u, v), 14, 40, -1)
            else:
                cv2.rectangle(image, (u - 12, v - 12), (u + 12, v + 12), 40, -1)
        image = cv2.GaussianBlur(cv2.warpAffine(image, turn, (800, 600), borderValue=200), (0, 0), 1.5)
        if is_round:
            assert len(detect(image, SYMMETRIC)) == SYMMETRIC.size
        else:
            with pytest.raises(TargetNotFound, match="square, not round"):
                detect(image, SYMMETRIC)


def test_equations_are_those_of_the_model() -> None:
    """The kernel against the model in numpy, with derivatives from differences."""
    rng = np.random.default_rng(3)
    image = rng.uniform(20.0, 200.0, (60, 70))
    shape = np.array([34.3, 28.8, 0.008, 0.002, 0.012, 1.3])
    light = np.array([180.0, 5.0, -3.0, -140.0, 4.0, 2.0])
    reach = 5.5

    def model(
        shape: np.ndarray, light: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        x, y = u - shape[0], v - shape[1]
        mx, my = shape[2] * x + shape[3] * y, shape[3] * x + shape[4] * y
        F, steep = np.sqrt(x * mx + y * my), np.hypot(mx, my)
        a = (1.0 - F) * F / steep
        unit = (shape[2] * shape[4] - shape[3] ** 2) ** 0.25
        P = np.vectorize(lambda z: 0.5 * math.erfc(-z / math.sqrt(2.0)))(a / shape[5])
        xn, yn = x * unit, y * unit
        return light[0] + light[1] * xn + light[2] * yn + (light[3] + light[4] * xn + light[5] * yn) * P, a

    v, u = (a.ravel().astype(float) for a in np.mgrid[0:60, 0:70])
    values, distance = model(shape, light, u, v)
    used = np.abs(distance) <= reach
    N, buffers = np.empty((ROWS, 16)), (np.zeros((ROWS, TOGETHER)), np.empty((3, TOGETHER)))
    count = write_equations(image, shape, light, reach, 1, N, *buffers)
    residual = image.ravel()[used] - values[used]
    assert count == used.sum()
    assert N[RESIDUAL, RESIDUAL] == pytest.approx(np.sum(residual**2))
    assert N[6, 6] == pytest.approx(count)
    assert N[RESIDUAL, 6] == pytest.approx(residual.sum())
    edge = np.abs(distance[used]) < 0.7  # derivatives are those at the edge
    J = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = 1e-6 * max(1.0, abs(shape[k])) if k in (0, 1, 5) else 1e-8
        up, down = (model(shape + sign * step, light, u[used], v[used])[0] for sign in (1.0, -1.0))
        J.append((up - down) / (2.0 * step[k]))
    numeric = np.array([np.sum(j**2) for j in J])
    assert edge.any()
    np.testing.assert_allclose(np.diag(N)[:6], numeric, rtol=0.12)


@pytest.mark.parametrize("first", [0, 6])
def test_equations_are_solved_as_numpy_solves_them(first: int) -> None:
    rng = np.random.default_rng(first)
    J, r = rng.normal(size=(40, 12)) * np.logspace(-3, 2, 12), rng.normal(size=40)
    N = np.zeros((14, 16))
    N[:12, :12], N[12, :12] = np.tril(J.T @ J), J.T @ r
    solution, covariance = np.zeros(12), np.zeros((2, 2))
    explained, solved = solve_equations(N, first, solution, covariance)
    assert solved
    expected = np.linalg.lstsq(J[:, first:], r, rcond=None)[0]
    np.testing.assert_allclose(solution[first:], expected, rtol=1e-6)
    assert not solution[:first].any()
    assert explained == pytest.approx(r @ J[:, first:] @ expected)
    if first == 0:
        np.testing.assert_allclose(covariance, np.linalg.inv(J.T @ J)[:2, :2], rtol=1e-6)
    N = np.zeros((14, 16))
    N[:12, :12] = np.tril(-J.T @ J)
    assert not solve_equations(N, first, solution, covariance)[1]


def test_the_normal_distribution_is_scipys() -> None:
    for z in np.linspace(-8.0, 8.0, 1001):
        upper, density = normal(float(z))
        assert upper == pytest.approx(0.5 * math.erfc(-z / math.sqrt(2.0)), abs=1e-8)
        assert density == pytest.approx(math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi), abs=1e-8)


def test_dots_fitted_together_are_those_fitted_alone() -> None:
    """And where the steps end, the gradient does: another step, from there, moves no centre."""
    scene = replace(scene_of(SYMMETRIC, 30.0, seed=1), noise_levels=4.0)
    image = render(scene)
    starts = np.array([[u + 0.8, v - 0.6, 0.007, 0.0, 0.008, 1.5] for u, v in scene.points_px[:20]])
    n = len(starts)
    shapes, contrast, covariance = np.zeros((n, 6)), np.zeros(n), np.zeros((n, 2, 2))
    variance, converged = np.zeros(n), np.zeros(n, dtype=np.bool_)
    options = (0.25, 12, 0.2, 0.7, 0.7)
    fit_each(image, starts, *options, shapes, contrast, covariance, variance, converged)
    assert converged.all()
    for k, start in enumerate(starts):
        shape, light, of_centre, noise, _ = fit_dot(image, start, *options)
        np.testing.assert_array_equal(shapes[k], shape)
        np.testing.assert_array_equal(covariance[k], of_centre)
        assert (contrast[k], variance[k]) == (light[3], noise)
        again = fit_dot(image, shape, 0.25, 12, 1e-3, 0.7, 0.7)[0]
        uncertainty = math.sqrt(float(np.trace(of_centre)) / 2.0 * noise)
        assert np.hypot(*(again[:2] - shape[:2])) < 0.5 * uncertainty


@pytest.mark.parametrize("share", [0.1, 0.45, 0.62, 0.9])
def test_patches_are_those_of_opencv(share: float) -> None:
    """Area, box and centre of what hangs together; moments by the pixels themselves."""
    mask = (np.random.default_rng(round(100 * share)).random((37, 53)) < share).astype(np.uint8)
    _, labels, statistics, centres = cv2.connectedComponentsWithStats(mask, connectivity=4, ltype=cv2.CV_32S)
    area, boxes, middles, second = patches(mask)
    expected = [n for n in dict.fromkeys(labels.ravel().tolist()) if n != 0]  # in the order they are met
    np.testing.assert_array_equal(area, statistics[expected, cv2.CC_STAT_AREA])
    np.testing.assert_array_equal(boxes, statistics[expected, :4])
    np.testing.assert_allclose(middles, centres[expected], atol=1e-12)
    for n, sums in zip(expected, second, strict=True):
        v, u = np.nonzero(labels == n)
        off = np.stack([u, v]) - centres[n][:, None]
        np.testing.assert_allclose(sums, off @ off.T + np.eye(2) * len(u) / 12.0, atol=1e-9)


def test_moments_of_a_rectangle() -> None:
    mask = np.zeros((12, 14), np.uint8)
    mask[2:7, 3:11] = 1
    area, boxes, middles, second = patches(mask)
    assert (area.tolist(), boxes.tolist(), middles.tolist()) == ([40.0], [[3, 2, 8, 5]], [[6.5, 4.0]])
    # of a rectangle w x h: w² / 12 and h² / 12 for each of its w h pixels
    np.testing.assert_allclose(second[0], np.diag([64.0 / 12.0, 25.0 / 12.0]) * 40.0, atol=1e-9)


def test_crosses_are_those_of_a_print_seen_aslant() -> None:
    """Any linear map of a square lattice of circles: its own steps, but for a quarter turn, and no irregularity."""
    A = np.array([[21.0, 6.0], [-4.0, 13.0]])
    q, p = np.mgrid[0:6, 0:7]
    centres = np.stack([p.ravel(), q.ravel()], axis=1) @ A.T + 100.0
    dots = Dots(centres, np.tile(0.25**2 * A @ A.T / 4.0, (42, 1, 1)), np.ones(42), are_dark=True)
    near = np.argsort(np.linalg.norm(centres[:, None] - centres[None], axis=2), axis=1, kind="stable")[
        :, 1:25
    ]
    steps, irregular = crosses(dots.centres, dots.moments, near)
    inner = np.flatnonzero(((p > 0) & (p < 6) & (q > 0) & (q < 5)).ravel())
    np.testing.assert_allclose(irregular[inner], 0.0, atol=1e-9)
    assert np.isinf(irregular[0])
    for step in steps[inner]:
        turn = np.linalg.solve(A, step.T)
        np.testing.assert_allclose(turn, np.rint(turn), atol=1e-9)
        assert np.linalg.det(turn) == pytest.approx(1.0)
    (lattice,) = dot_lattices(dots)
    assert sorted(lattice.dots.tolist()) == list(range(42))
    terms = np.column_stack([lattice.places, np.ones(42)])
    turn = np.linalg.solve(A, np.linalg.lstsq(terms, centres[lattice.dots], rcond=None)[0][:2].T)
    np.testing.assert_allclose(turn, np.rint(turn), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_squares_are_no_part_of_a_board_of_dots() -> None:
    """A grille that runs out of the image: a lattice, but not of dots."""
    image = np.full((500, 700), 190, np.uint8)
    for v in range(40, 500, 40):
        for u in range(200, 740, 40):
            image[v - 10 : v + 10, u - 10 : u + 10] = 40
    with pytest.raises((TargetNotFound, TargetMismatch)):
        detect(cv2.GaussianBlur(image, (0, 0), 1.0), TargetSpec("circles", 20, 15, 20.0))
    for v in range(40, 500, 40):
        for u in range(200, 740, 40):
            image[v - 15 : v + 15, u - 15 : u + 15] = 190
            cv2.circle(image, (u, v), 11, 40, -1, cv2.LINE_AA)
    with pytest.raises(OriginUnknown):
        detect(cv2.GaussianBlur(image, (0, 0), 1.0), TargetSpec("circles", 20, 15, 20.0))
