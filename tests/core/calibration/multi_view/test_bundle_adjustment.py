"""Compiled passes over many views against the same formulas in plain numpy."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from core.calibration.multi_view.linearisation import Linearised, linearise
from core.calibration.multi_view.repeat_consistency import (
    MIN_VIEWS_FOR_MEDIAN,
    find_repeats,
    inliers_of,
    is_same_scene,
)
from core.calibration.multi_view.view_stack import (
    Placements,
    ViewStack,
    coordinates,
    medians,
    segment_sums,
    stack_views,
)
from core.calibration.residuals.one_view import residuals_with_jacobian
from core.calibration.state import SMALLEST_NOISE_PX
from core.geometry.se3 import rotations_from_vectors, so3_exp
from core.numerics.least_squares import CAUCHY_C, MEDIAN_LENGTH, REJECTION
from core.numerics.schur import KNOWN, SHARED_CAMERA, Sharing, arrow, free_focal
from core.targets.specification import GridPoints
from tests.support.simulation.simulated_views import draw_camera, draw_view


@pytest.fixture(scope="module")
def seen() -> tuple[ViewStack, Placements, np.ndarray]:
    """Seven views of one camera, the last two of one pose, points missing here and there, at wrong placements."""
    rng = np.random.default_rng(5)
    camera = draw_camera(rng)
    views: list[GridPoints] = []
    rotations, translations = [], []
    for i in range(7):
        view = draw_view(rng, tilt_deg=20.0 + i, camera=camera, columns=7 + i % 2, rows=5)
        there = np.flatnonzero(rng.random(len(view.points)) > (0.0 if i > 4 else 0.2))
        p = view.points
        views.append(
            dataclasses.replace(
                p,
                column=p.column[there],
                row=p.row[there],
                points_px=p.points_px[there],
                standard_uncertainty_px=rng.uniform(0.02, 0.08, len(there)),
            )
        )
        rotations.append(so3_exp(rng.normal(0.0, 1e-3, 3)) @ view.T_camera_target[:3, :3])
        centroid = views[-1].points_target.mean(axis=0)
        translations.append(view.T_camera_target[:3, :3] @ centroid + view.T_camera_target[:3, 3])
    at = Placements(np.tile(camera.as_array(), (7, 1)), np.array(rotations), np.array(translations))
    stack = stack_views(views)
    return stack, at, rng.random(len(stack.column)) > 0.1


def plain(views: ViewStack, at: Placements, used: np.ndarray, *, robust: bool) -> Linearised:
    """What `linearise` computes, view by view."""
    products, residuals, squared, cost = [], [], [], 0.0
    for i in range(len(views)):
        part = views.part(i)
        target = np.ascontiguousarray((views.points_target[part] - views.points_target[part].mean(axis=0)).T)
        observed = np.ascontiguousarray(views.points_px[part].T)
        r, J = residuals_with_jacobian(
            target, observed, at.parameters[i], at.rotations[i], at.translations_mm[i], 8
        )
        weight = 1.0 / views.standard_uncertainty_px[part] ** 2
        d = np.sum(r * r, axis=0) * weight
        if robust:
            scale = np.sqrt(np.median(d)) / MEDIAN_LENGTH[2]
            weight = weight / (scale**2 * (1.0 + d / (CAUCHY_C * scale) ** 2))
            cost += 2.0 * len(d) * float(np.log(scale))
        else:
            weight = weight * used[part]
            cost += float(d @ used[part])
        rows = np.concatenate([J, r[None]])
        products.append(np.einsum("amn,bmn,n->ab", rows, rows, weight))
        residuals.append(r)
        squared.append(d)
    return Linearised(
        at, np.array(products), np.concatenate(residuals, axis=1), np.concatenate(squared), cost
    )


@pytest.mark.parametrize("robust", [False, True])
def test_normal_equations(seen: tuple[ViewStack, Placements, np.ndarray], robust: bool) -> None:
    found, expected = linearise(*seen, robust=robust), plain(*seen, robust=robust)
    np.testing.assert_allclose(found.residuals, expected.residuals, rtol=1e-12, atol=1e-10)
    np.testing.assert_allclose(found.squared, expected.squared, rtol=1e-9, atol=1e-12)
    unit = np.sqrt(np.einsum("kii->ki", expected.products))
    difference = (found.products - expected.products) / (unit[:, :, None] * unit[:, None, :])
    np.testing.assert_allclose(difference, 0.0, atol=1e-11)
    np.testing.assert_array_equal(found.products, np.swapaxes(found.products, 1, 2))
    assert found.cost == pytest.approx(expected.cost, rel=1e-10)


@pytest.mark.parametrize("sharing", [SHARED_CAMERA, free_focal(8), KNOWN])
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_elimination(
    seen: tuple[ViewStack, Placements, np.ndarray], sharing: Sharing, damping: float
) -> None:
    """The step of all coordinates at once, from the whole matrix; a view without points stays where it is."""
    views, placements, used = seen
    used = used & (views.spread(np.arange(len(views))) != 3)
    at = linearise(views, placements, used)
    s, own = len(sharing.common), len(sharing.local)
    rng = np.random.default_rng(1)
    Q, q = rng.normal(size=(s, s)), rng.normal(size=s)
    weight = 0.7
    found = arrow(at.products, placements.parameters, sharing, weight, (Q.T @ Q, Q.T @ q), damping)
    size = s + own * len(views)
    whole, right = np.zeros((size, size)), np.zeros(size)
    whole[:s, :s], right[:s] = Q.T @ Q, Q.T @ q
    for i in range(len(views)):
        change = np.eye(14)
        change[:8, :8] = coordinates(placements.parameters[i])
        N, g = weight * change.T @ at.normal[i] @ change, weight * change.T @ at.products[i, :-1, -1]
        columns = [*sharing.common, *sharing.local]
        places = [*range(s), *range(s + own * i, s + own * (i + 1))]
        whole[np.ix_(places, places)] += N[np.ix_(columns, columns)]
        right[places] += g[columns]
        if i == 3:
            whole[places[s:], places[s:]] = 1.0
    undamped = whole.copy()
    whole[np.diag_indices(size)] *= 1.0 + damping
    step = np.linalg.solve(whole, right)
    common, of_views = found.solve()
    unit = np.sqrt(np.diag(undamped))
    np.testing.assert_allclose((common - step[:s]) * unit[:s], 0.0, atol=1e-6 * np.abs(step * unit).max())
    np.testing.assert_allclose(
        (of_views.ravel() - step[s:]) * unit[s:], 0.0, atol=1e-6 * np.abs(step * unit).max()
    )
    assert not of_views[3].any()
    if not damping and s:
        covariance = np.linalg.inv(whole)[:s, :s]
        np.testing.assert_allclose(np.linalg.inv(found.head), covariance, rtol=1e-6)
        information = np.linalg.inv(covariance)
        lengths = [
            np.sqrt(max(step[:s] @ information @ step[:s], 0.0)),
            *(
                np.sqrt(part @ undamped[k : k + own, k : k + own] @ part)
                for part, k in zip(step[s:].reshape(-1, own), range(s, size, own), strict=True)
            ),
        ]
        assert found.longest(common, of_views) == pytest.approx(max(lengths), rel=1e-6)


def judged(views: ViewStack, pose: list[int], residuals: np.ndarray) -> dict[int, np.ndarray]:
    """What `inliers.judge_pose` decides, in plain numpy."""
    of_cell: dict[int, list[np.ndarray]] = {}
    levels, floors = {}, {}
    root = 1.0 / views.standard_uncertainty_px
    for i in pose:
        part = views.part(i)
        floors[i] = SMALLEST_NOISE_PX * float(np.median(root[part]))
        levels[i] = max(float(np.median(np.hypot(*residuals[:, part]) * root[part])), floors[i])
        for cell, r, w in zip(views.cell[part], residuals[:, part].T, root[part], strict=True):
            of_cell.setdefault(int(cell), []).append(np.array([*r, w]))
    limit = REJECTION * np.median(list(levels.values()))
    median = {cell: np.median(np.array(rows)[:, :2], axis=0) for cell, rows in of_cell.items()}
    systematic = {
        cell: float(np.hypot(*median[cell]) * np.mean(np.array(rows)[:, 2])) for cell, rows in of_cell.items()
    }
    result = {}
    for i in pose:
        part = views.part(i)
        cells = [int(cell) for cell in views.cell[part]]
        away = residuals[:, part].T - np.array([median[cell] for cell in cells])
        deviation = np.hypot(*away.T) * root[part]
        of_view = REJECTION * max(float(np.median(deviation)), floors[i])
        result[i] = np.array(
            [
                systematic[cell] <= limit
                and d <= max(of_view, systematic[cell] if len(of_cell[cell]) >= MIN_VIEWS_FOR_MEDIAN else 0.0)
                for cell, d in zip(cells, deviation, strict=True)
            ]
        )
    return result


@pytest.mark.parametrize(
    ("freedom", "least", "most"),
    [
        pytest.param(1.5, 0.02, 0.5, id="many gross errors"),
        pytest.param(1e6, 0.0, 0.02, id="hardly any"),
    ],
)
def test_inliers(
    freedom: float, least: float, most: float, seen: tuple[ViewStack, Placements, np.ndarray]
) -> None:
    views, _, _ = seen
    rng = np.random.default_rng(2)
    residuals = rng.standard_t(freedom, (2, len(views.column))) * 0.05
    labels = [0, 1, 0, 1, 0, 1, 2]
    kept = np.array([True, True, True, False, True, True, True])
    used = inliers_of(views, find_repeats(views, np.array(labels)), residuals, kept)
    assert least <= np.mean(~used[np.repeat(kept, views.counts)]) <= most
    assert not used[views.part(3)].any()
    poses: dict[tuple[int, int], list[int]] = {}
    for i in np.flatnonzero(kept).tolist():
        poses.setdefault((labels[i], int(views.target[i])), []).append(i)
    for pose in poses.values():
        for i, expected in judged(views, pose, residuals).items():
            np.testing.assert_array_equal(used[views.part(i)], expected)


def test_medians_and_sums_of_segments() -> None:
    values = np.random.default_rng(3).normal(size=20)
    values[:5] = 0.7
    first = np.array([0, 5, 5, 11, 20])
    parts = [values[a:b] for a, b in pairwise(first)]
    expected = [float(np.median(p)) if len(p) else 0.0 for p in parts]
    np.testing.assert_array_equal(medians(values, first), expected)
    np.testing.assert_allclose(segment_sums(values, first), [p.sum() for p in parts], atol=1e-14)
    assert not segment_sums(np.zeros(0), np.zeros(3, dtype=np.intp)).any()


def test_rotations_of_many_vectors() -> None:
    vectors = np.vstack([np.random.default_rng(4).normal(size=(20, 3)), np.zeros(3), [1e-7, 0, 0]])
    np.testing.assert_allclose(
        rotations_from_vectors(vectors), [so3_exp(w) for w in vectors], rtol=0, atol=1e-15
    )


def test_a_stack_gives_back_its_views(seen: tuple[ViewStack, Placements, np.ndarray]) -> None:
    views, _, _ = seen
    some = views.take([4, 1])
    for k, i in enumerate((4, 1)):
        assert some.view(k) == views.view(i)
        np.testing.assert_array_equal(some.view(k).points_target, views.view(i).points_target)
        np.testing.assert_allclose(some.centroids[k], views.view(i).points_target.mean(axis=0))
    assert views.take(range(len(views))) is views


def test_views_are_one_scene_where_they_list_the_same_cells(
    seen: tuple[ViewStack, Placements, np.ndarray],
) -> None:
    views = seen[0]
    for i, j in pairwise(range(len(views))):
        listed = [views.cell[views.part(k)].tolist() for k in (i, j)]
        assert is_same_scene(views, np.array([i, j])) == (listed[0] == listed[1])
    assert is_same_scene(views, np.array([5, 5]))
    assert not is_same_scene(views, np.array([3, 5]))
