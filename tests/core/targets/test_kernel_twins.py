"""The detector's compiled parts against plain numpy that does the same, on lattices with holes and images of noise."""

from __future__ import annotations

import numpy as np
import pytest

from core.numerics.order_statistics import median, quantiles
from core.targets.lattice.board_boundary import bounding_box, known_around, look_at_sides, square_heights
from core.targets.lattice.corner_graph import into_cells, spread
from core.targets.lattice.lattice import bent_points, poorly_connected
from core.targets.lattice.saddle_points import mixed_derivatives
from core.targets.subpixel import corner_model as model
from core.targets.subpixel.corner_motion import follow_edges


def lattice_with_holes(
    rng: np.random.Generator, rows: int, columns: int, missing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return grid (rows, columns, 2) and gap, NaN where missing, of a bent and tilted grid with some corners astray."""
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    grid = np.stack([30 + 14 * x + 2 * y + 0.1 * x * y, 25 - 1.5 * x + 12 * y - 0.2 * y * y], axis=2)
    grid += rng.normal(0.0, 0.3, grid.shape) + (rng.random((rows, columns)) < 0.05)[..., None] * 6.0
    gap = rng.uniform(20.0, 60.0, (rows, columns))
    out = rng.random((rows, columns)) < missing
    grid[out], gap[out] = np.nan, np.nan
    return grid, gap


@pytest.mark.parametrize("count", [1, 2, 3, 50, 51])
def test_quantiles_are_numpys(count: int) -> None:
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == pytest.approx(np.median(values), rel=1e-14)
    shares = (0.0, 0.4, 0.99, 1.0)
    np.testing.assert_allclose(quantiles(values, shares), np.quantile(values, shares), rtol=1e-12)


@pytest.mark.parametrize("dtype", [np.int16, np.float32])
@pytest.mark.parametrize("step", [1, 2, 7])
def test_mixed_derivatives(dtype: type, step: int) -> None:
    smooth = np.random.default_rng(step).integers(-900, 900, (33, 41)).astype(dtype)
    f = smooth.astype(np.float64)
    mixed = f[2:, 2:] - f[2:, :-2] - f[:-2, 2:] + f[:-2, :-2]
    np.testing.assert_allclose(mixed_derivatives(smooth, step), np.abs(mixed[::step, ::step]).ravel())


@pytest.mark.parametrize("seed", range(5))
def test_kinks_and_lonely_ones(seed: int) -> None:
    grid, gap = lattice_with_holes(np.random.default_rng(seed), 7, 9, 0.3)
    expected = np.zeros(gap.shape, dtype=bool)
    for lines, marks in ((grid, expected), (np.swapaxes(grid, 0, 1), expected.T)):
        steps = np.diff(lines, axis=0)
        length, bend = np.linalg.norm(steps, axis=2), np.linalg.norm(np.diff(steps, axis=0), axis=2)
        marks[1:-1] |= bend > 0.35 * np.maximum(length[1:], length[:-1])
    assert expected.any()
    np.testing.assert_array_equal(bent_points(grid), expected)
    known = np.isfinite(gap)
    around = np.pad(known.astype(int), 1)
    neighbours = around[:-2, 1:-1] + around[2:, 1:-1] + around[1:-1, :-2] + around[1:-1, 2:]
    assert (known & (neighbours < 2)).any()
    np.testing.assert_array_equal(poorly_connected(known), known & (neighbours < 2))


def test_cells_hold_their_points_in_order() -> None:
    points = np.random.default_rng(3).uniform(0.0, 60.0, (200, 2)).astype(np.float32)
    cells, order, starts = into_cells(points, np.float32(7.5), 9, 9)
    np.testing.assert_array_equal(cells, (points / np.float32(7.5)).astype(int))
    cell_of = cells[:, 1] * 9 + cells[:, 0]
    np.testing.assert_array_equal(order, np.argsort(cell_of, kind="stable"))
    np.testing.assert_array_equal(starts, np.searchsorted(cell_of[order], np.arange(82)))


def plain_spread(links: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patches by following links breadth first, as sets and lists do it."""
    count = len(links)
    patch, place, turned = np.full(count, -1), np.zeros((count, 2), dtype=int), np.zeros(count, dtype=int)
    members: list[list[int]] = []
    steps = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
    for seed in np.argsort(-np.sum(links >= 0, axis=1), kind="stable"):
        if patch[seed] >= 0 or not np.any(links[seed] >= 0):
            continue
        queue = [int(seed)]
        patch[seed] = len(members)
        for p in queue:
            for k, q in enumerate(links[p]):
                if q >= 0 and patch[q] < 0:
                    way = (k + turned[p]) % 4
                    patch[q], place[q] = len(members), place[p] + steps[way]
                    turned[q] = (way + 2 - list(links[q]).index(p)) % 4
                    queue.append(int(q))
        members.append(queue)
    by_size = sorted(range(len(members)), key=lambda n: -len(members[n]))
    for number, old in enumerate(by_size):
        patch[members[old]] = number
    return patch, place, np.array([len(members[n]) for n in by_size])


@pytest.mark.parametrize("seed", range(5))
def test_patches_spread_along_the_links(seed: int) -> None:
    """On a grid whose corners number their rays from any of the four on, with links cut at random."""
    rng = np.random.default_rng(seed)
    rows, columns = 6, 8
    first = rng.integers(0, 4, rows * columns)
    links = np.full((rows * columns, 4), -1)
    for j in range(rows):
        for i in range(columns):
            for way, (di, dj) in enumerate(((1, 0), (0, 1))):
                if i + di < columns and j + dj < rows and rng.random() < 0.4:
                    p, q = j * columns + i, (j + dj) * columns + i + di
                    links[p, (way - first[p]) % 4], links[q, (way + 2 - first[q]) % 4] = q, p
    found, expected = spread(links), plain_spread(links)
    assert len(expected[2]) > 1
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def plain_side(
    image: np.ndarray, lines: np.ndarray, gap: np.ndarray, first_is_bright: bool, beyond: np.ndarray
) -> tuple[float, float, float, float]:
    """One side of a lattice in plain numpy: the outermost three lines given, the outermost first."""
    outer, inner = lines[0], lines[1]
    bent = 3.0 * outer - 3.0 * inner + lines[2]
    places = np.where(np.isfinite(bent), bent, 2.0 * outer - inner)
    good = np.isfinite(places[:, 0])
    seen = float(np.isfinite(gap).mean())
    if good.sum() < 2:
        return seen, 0.0, 0.0, 0.0
    number = np.flatnonzero(good)
    places, outer = places[good], outer[good]
    limit = np.array(image.shape[::-1]) - 3.0
    visible = np.all((places >= 2.0) & (places <= limit), axis=1)
    after, before = (
        np.minimum(np.arange(len(number)) + 1, len(number) - 1),
        np.maximum(np.arange(len(number)) - 1, 0),
    )
    along = 0.3 * (outer[after] - outer[before]) / (number[after] - number[before])[:, None]
    depths = np.append(np.arange(0.4, 0.95, 0.1), 1.3)
    middle = outer + depths[:, None, None] * (places - outer)
    levels = []
    for at in (middle + along, middle - along):
        u, v = np.rint(np.clip(at, 0.0, np.array(image.shape[::-1]) - 1.0)).astype(int).transpose(2, 0, 1)
        levels.append(image[v, u].astype(float))
    sign = np.where((number % 2 == 0) == first_is_bright, 1.0, -1.0)
    step = (levels[0] - levels[1]) * sign
    depth = np.logical_and.accumulate(step[:-1] > 0.25 * gap[good], axis=0).sum(axis=0)
    inside = np.all((middle[-1] >= 0.0) & (middle[-1] <= limit + 2.0), axis=1)
    follows = ~inside | ~(-step[-1] < 0.5 * gap[good])
    right = visible & (np.abs(depth - np.sort(depth)[len(depth) // 2]) <= 1)
    count = max(int(visible.sum()), 1)
    squares = right.sum() / (count + len(gap) - len(number))
    in_view = float(visible.mean())
    if visible.sum() < 3 and (in_view < 0.5 or follows[visible].all()):
        in_view = 0.0
    return seen, in_view, float(squares), (beyond[good] & visible & follows).sum() / count


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("seed", range(6))
def test_sides_of_a_lattice(dtype: type, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = np.kron(rng.integers(0, 2, (12, 15)), np.ones((12, 12), int)) * 150 + rng.integers(
        0, 40, (144, 180)
    )
    grid, gap = lattice_with_holes(rng, 6 + seed % 2, 8 + seed // 2 % 2, 0.2)
    bright = bool(seed % 2)
    around = rng.random((4, max(gap.shape))) < 0.3
    rows, columns = gap.shape
    gaps = (gap[0], gap[-1], gap[:, 0], gap[:, -1])
    colours = (not bright, bright == (rows % 2 == 1), not bright, bright == (columns % 2 == 1))
    turn = np.array([[1.0, 0.15], [-0.15, 1.0]])
    for moved in np.linspace(-80.0, 80.0, 17):  # until one or two places of a side are left in the image
        turned = grid @ turn + moved
        found = look_at_sides(image.astype(dtype), turned, gap, bright, around)
        across = np.swapaxes(turned, 0, 1)
        for side, lines in enumerate((turned[:3], turned[::-1][:3], across[:3], across[::-1][:3])):
            beyond = around[side, : len(gaps[side])]
            expected = plain_side(image, lines, gaps[side], colours[side], beyond)
            np.testing.assert_allclose(found[side], expected, rtol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_a_lattices_box_and_what_is_around(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = np.zeros((9, 11), dtype=bool)
    known[2:7, 3:9] = rng.random((5, 6)) < 0.9
    known |= rng.random(known.shape) < 0.12
    top, bottom, left, right = 0, 9, 0, 11
    while bottom > top and right > left:
        part = known[top:bottom, left:right]
        lines = (part[0], part[-1], part[:, 0], part[:, -1])
        side = int(np.argmin([line.mean() for line in lines]))
        if lines[side].mean() >= 0.3 and lines[side].sum() >= 2:
            break
        top, bottom, left, right = (
            top + (side == 0),
            bottom - (side == 1),
            left + (side == 2),
            right - (side == 3),
        )
    assert bounding_box(known) == (top, bottom, left, right)
    padded = np.pad(known, 1)
    around = known_around(known, top, bottom, left, right)
    rows, columns = slice(top + 1, bottom + 1), slice(left + 1, right + 1)
    np.testing.assert_array_equal(around[0, : right - left], padded[top, columns])
    np.testing.assert_array_equal(around[1, : right - left], padded[bottom + 1, columns])
    np.testing.assert_array_equal(around[2, : bottom - top], padded[rows, left])
    np.testing.assert_array_equal(around[3, : bottom - top], padded[rows, right + 1])


def test_the_height_of_squares() -> None:
    grid, _ = lattice_with_holes(np.random.default_rng(2), 7, 9, 0.2)
    across, down = np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1]
    area = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])
    longer = np.maximum(np.linalg.norm(across, axis=2), np.linalg.norm(down, axis=2))
    expected = (area / longer)[np.isfinite(area)]
    assert 5 < len(expected) < 48
    np.testing.assert_allclose(square_heights(grid), expected, rtol=1e-12)


def test_a_lattice_without_corners_has_no_box() -> None:
    top, bottom, left, right = bounding_box(np.zeros((4, 5), dtype=bool))
    assert bottom <= top or right <= left


def test_corners_follow_their_edges() -> None:
    rng = np.random.default_rng(8)
    count = 30
    states, steps = np.zeros((count, model.STATE)), np.zeros((count, model.STEP))
    states[:, :10] = rng.normal(size=(count, 10))
    angle = rng.uniform(0.0, 0.6, (2, count)) + np.array([[0.0], [1.3]])
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=2)  # of the two edges
    states[:, [model.N1_U, model.N1_V]], states[:, [model.N2_U, model.N2_V]] = normals
    states[:, [model.REACH_1, model.REACH_2]] = rng.uniform(3.0, 30.0, (count, 2))
    along_x, along_y, bend_x, bend_y = (
        rng.normal(size=(4, count, 2)) * np.array([40, 40, 0.5, 0.5])[:, None, None]
    )
    before = states.copy()
    follow_edges(states, steps, along_x, along_y, bend_x, bend_y)
    shifts, turns = [], []
    for k, (along, bend) in enumerate(((along_y, bend_y), (along_x, bend_x))):
        at_bend, at_reach = ((model.BEND_1, model.REACH_1), (model.BEND_2, model.REACH_2))[k]
        length = np.linalg.norm(along, axis=1)
        now = np.sum(normals[k] * bend, axis=1) / length**2
        np.testing.assert_allclose(states[:, at_bend], now, rtol=1e-12)
        shifts.append((before[:, at_bend] - now) * before[:, at_reach] ** 2 / 6.0)
        turns.append(np.sum(normals[k] * along, axis=1) / length * before[:, at_reach])
    moved = np.linalg.solve(normals.transpose(1, 0, 2), np.stack(shifts, axis=1)[..., None])[..., 0]
    at = [model.Q_U, model.Q_V]
    np.testing.assert_allclose(states[:, at] - before[:, at], moved, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(steps[:, model.UNEVEN], turns[1] - turns[0], rtol=1e-9, atol=1e-12)
