"""The parts of the detector one by one, the compiled ones against plain twins."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from core.targets.chessboard.orientation import orient
from core.targets.lattice.board_boundary import bounded
from core.targets.lattice.corner_graph import link
from core.targets.lattice.growing import grow_lattice
from core.targets.lattice.lattice import Lattice, bent_points, spacing
from core.targets.lattice.pyramid import Level, levels
from core.targets.lattice.rings import rings
from core.targets.lattice.saddle_points import find_saddles, saddle_points

PITCH = 24


def board(columns: int, rows: int, margin: int = 2, blur: float = 0.7) -> tuple[np.ndarray, np.ndarray]:
    """Return a drawn board (square (-1, -1) black) and its grid, upright."""
    squares = np.ones((rows + 1 + 2 * margin, columns + 1 + 2 * margin), np.float32)
    squares[margin:-margin, margin:-margin] = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2
    image = np.kron(squares, np.ones((PITCH, PITCH), np.float32)) * 180.0 + 20.0
    y, x = np.mgrid[0:rows, 0:columns]
    grid = (np.stack([x, y], axis=2) + margin + 1.0) * PITCH - 0.5
    return np.rint(cv2.GaussianBlur(image, (0, 0), blur)).astype(np.uint8), grid


def lattice_of(grid: np.ndarray, *, origin_is_bright: bool) -> Lattice:
    shape = grid.shape[:2]
    return Lattice(grid, np.full(shape, 100.0), np.zeros(shape, dtype=bool), origin_is_bright)


def noisy_image() -> np.ndarray:
    """A board, tilted by a shear, with noise, blobs and bars around it."""
    image, _ = board(7, 5)
    shear = np.array([[0.9, 0.35, 10.0], [-0.2, 0.7, 60.0]])
    image = cv2.warpAffine(image, shear, (300, 260), borderValue=120.0)
    cv2.circle(image, (250, 40), 9, 10, -1, cv2.LINE_AA)
    cv2.line(image, (10, 230), (280, 250), 30, 3, cv2.LINE_AA)
    noise = np.random.default_rng(5).normal(0.0, 3.0, image.shape)
    return np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)


def test_spacing_is_to_the_nearest_neighbour() -> None:
    _, grid = board(4, 3)
    stretched = grid * np.array([1.0, 1.5])
    np.testing.assert_allclose(spacing(stretched), PITCH)


def test_a_lens_makes_no_kinks_and_a_mistake_does() -> None:
    _, grid = board(9, 6)
    y, x = np.mgrid[-1:1:6j, -1:1:9j]
    lens = grid + np.stack([x, y], axis=2) * (x * x + y * y)[..., None] * 10.0
    for smooth in (grid, lens, grid / (1.0 + 2e-3 * grid[..., :1])):
        assert not bent_points(smooth).any()
    wrong = grid.copy()
    wrong[2, 3] += (PITCH / 2, 0.0)
    assert bent_points(wrong)[2, 3]
    assert not bent_points(wrong)[:, 6:].any()
    gappy = grid.copy()
    gappy[1, 4] = np.nan
    assert not bent_points(gappy).any()


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


@pytest.mark.parametrize("turn", range(4))
def test_links_make_one_patch_in_order(turn: int) -> None:
    image, _ = board(8, 5)
    saddles = find_saddles(Level(np.ascontiguousarray(np.rot90(image, turn)), 0))
    patches = link(saddles)
    assert list(patches.sizes) == [40]
    place = patches.place - patches.place.min(axis=0)
    assert sorted(place.max(axis=0)) == [4, 7]
    assert len(np.unique(place, axis=0)) == 40
    # an affine map takes places to pixels, and does not mirror
    A = np.column_stack([place, np.ones(40)])
    found, *_ = np.linalg.lstsq(A, saddles.points.astype(np.float64), rcond=None)
    np.testing.assert_allclose(A @ found, saddles.points, atol=0.1)
    assert np.linalg.det(found[:2]) > 0.0


def test_colours_of_places_are_right() -> None:
    image, _ = board(8, 5)
    saddles = find_saddles(Level(image, 0))
    patches = link(saddles)
    for point, place in zip(saddles.points, patches.place, strict=True):
        a = saddles.points[np.argmin(np.abs(patches.place - place - (1, 0)).sum(axis=1))] - point
        b = saddles.points[np.argmin(np.abs(patches.place - place - (0, 1)).sum(axis=1))] - point
        if np.linalg.norm(a) < 1.0 or np.linalg.norm(b) < 1.0:
            continue  # at the end of the board
        u, v = np.rint(point + (a + b) / 2.0).astype(int)
        assert (image[v, u] > 100) == (place.sum() % 2 == 0)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("corner", [(0, 0), (3, 2), (6, 4)])
def test_growing_finds_the_whole_board_and_stops(dtype: type, corner: tuple[int, int]) -> None:
    image, grid = board(8, 6)
    image = image.astype(dtype) * (1 if dtype is np.uint8 else 100)
    i, j = corner
    place = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    points = np.array([grid[j + y, i + x] for x, y in place]) + np.random.default_rng(1).uniform(
        -2, 2, (4, 2)
    )
    if (i + j) % 2 == 0:  # the square there is black: places begin at a bright one
        place = place + np.array([1, 0])
    lattice = grow_lattice(image, points, place)
    np.testing.assert_allclose(lattice.grid, grid, atol=0.05)
    assert not lattice.origin_is_bright
    assert not lattice.outside.any()
    found = bounded(image, lattice)
    assert found is not None
    assert found.is_whole
    assert found.size == (8, 6)


def test_a_part_hidden_is_grown_around_and_missing() -> None:
    image, grid = board(12, 9)
    cv2.circle(image, tuple(np.rint(grid[4, 5]).astype(int).tolist()), 30, 255, -1)
    saddles = find_saddles(Level(image, 0))
    patches = link(saddles)
    first = np.flatnonzero(patches.patch == 0)
    lattice = grow_lattice(image, saddles.points[first].astype(np.float64), patches.place[first])
    if lattice.gap.shape != (9, 12):
        lattice = lattice.quarter_turn()
    lattice = orient(lattice)[0]
    hidden = np.linalg.norm(grid - grid[4, 5], axis=2) < 31
    near = np.linalg.norm(grid - grid[4, 5], axis=2) < 30 + 0.4 * PITCH  # part of whose squares is hidden
    assert not lattice.known[hidden].any()
    assert lattice.known[~near].all()


def test_ends_are_distinguished_from_parts() -> None:
    image, grid = board(8, 6)
    whole = lattice_of(grid, origin_is_bright=False)
    found = bounded(image, whole)
    assert found is not None
    assert [side.is_boundary for side in found.sides] == [True] * 4
    # a line of corners beyond that was not grown: its squares still alternate, but growing decides on corners there
    gappy = lattice_of(grid.copy(), origin_is_bright=False)
    gappy.grid[0, 1:7], gappy.gap[0, 1:7] = (
        np.nan,
        np.nan,
    )  # two of eight: no line of the board, yet something
    found = bounded(image, gappy)
    assert found is not None
    assert found.size == (8, 5)
    assert found.sides[0].continues
    assert not found.is_whole


def test_corners_of_clutter_beyond_a_board_are_no_line_of_it() -> None:
    """What is in the margin at a corner's place; a line's squares would change their colour there."""
    image, grid = board(8, 6)
    above = 2.0 * grid[0] - grid[1]
    lattice = lattice_of(np.concatenate([above[None], grid]), origin_is_bright=True)
    lattice.grid[0, [0, 1, 2, 5, 6, 7]] = np.nan
    lattice.gap[0, [0, 1, 2, 5, 6, 7]] = np.nan
    found = bounded(image, lattice)
    assert found is not None
    assert found.size == (8, 6)
    assert found.sides[0].is_boundary
    assert found.is_whole


@pytest.mark.parametrize("side", range(4))
def test_an_image_that_ends_with_the_corners_does_not_show_a_whole_board(side: int) -> None:
    image, _ = board(8, 6)  # a margin of two squares, and the outermost one
    part = np.ascontiguousarray(np.rot90(image, side)[:, : -round(2.6 * PITCH)])
    saddles = find_saddles(Level(part, 0))
    patches = link(saddles)
    first = np.flatnonzero(patches.patch == 0)
    found = bounded(part, grow_lattice(part, saddles.points[first].astype(np.float64), patches.place[first]))
    assert found is not None
    assert found.size == (8, 6)
    assert found.continues
    assert not found.is_whole


@pytest.mark.parametrize("depth", [0.55, 0.8])
def test_a_board_cut_to_fit_its_plate_is_whole(depth: float) -> None:
    image, grid = board(8, 6)
    image = image.copy()
    image[:, round(grid[0, -1, 0] + depth * PITCH) :] = 200
    image[:, : round(grid[0, 0, 0] - depth * PITCH)] = 200
    found = bounded(image, lattice_of(grid, origin_is_bright=False))
    assert found is not None
    assert found.is_whole


def test_outermost_squares_that_end_unevenly_are_hidden_ones() -> None:
    image, grid = board(8, 6)
    image = image.copy()
    right = grid[:, -1, 0] + np.linspace(0.38, 1.2, 6) * PITCH  # a slanting edge over the last squares
    outline = np.array(
        [[right[0], grid[0, 0, 1] - PITCH], [right[-1], grid[-1, 0, 1] + PITCH], [999, 999], [999, 0]]
    )
    cv2.fillConvexPoly(image, np.rint(outline).astype(np.int32), 200)
    found = bounded(image, lattice_of(grid, origin_is_bright=False))
    assert found is not None
    assert [side.is_boundary for side in found.sides] == [True, True, True, False]


@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (4, 5), (6, 4), (7, 5), (4, 4), (5, 5)])
@pytest.mark.parametrize("turns", range(4))
def test_orientation_undoes_every_turn_it_can(columns: int, rows: int, turns: int) -> None:
    _, grid = board(columns, rows)
    upright = lattice_of(grid, origin_is_bright=False)
    given = upright
    for _ in range(turns):
        given = given.quarter_turn()
    if turns % 2 == 1 and rows != columns:
        given = given.quarter_turn()  # lattices handed over have the target's rows and columns
    oriented, warnings = orient(given)
    np.testing.assert_array_equal(
        oriented.grid, grid
    )  # upright and black at the origin is right by every rule
    assert not oriented.origin_is_bright
    assert [w.code for w in warnings] == ([] if (columns + rows) % 2 else ["board_symmetry_unresolved"])


def test_a_quarter_turn_knows_the_colour_of_its_origin() -> None:
    image, grid = board(5, 4)
    lattice = lattice_of(grid, origin_is_bright=False)
    for _ in range(4):
        lattice = lattice.quarter_turn()
        u, v = np.rint(lattice.grid[:2, :2].mean(axis=(0, 1))).astype(int)
        assert lattice.origin_is_bright == bool(image[v, u] > 100)
    for top, left in ((0, 1), (1, 1), (2, 1)):
        part = lattice.cut(top, 4, left, 5)
        u, v = np.rint(part.grid[:2, :2].mean(axis=(0, 1))).astype(int)
        assert part.origin_is_bright == bool(image[v, u] > 100)


def test_direction_decides_only_where_colour_cannot() -> None:
    _, odd = board(5, 4)
    oriented, _ = orient(lattice_of(odd, origin_is_bright=True))
    np.testing.assert_array_equal(oriented.grid, odd[::-1, ::-1])
    _, even = board(6, 4)
    oriented, _ = orient(
        lattice_of(even, origin_is_bright=True)
    )  # printed the other way round: white at both ends
    np.testing.assert_array_equal(oriented.grid, even)
