"""Noise that neighbouring grid points share: what it makes of the scatter of poses."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial import KDTree

from core.calibration.multi_view.estimators import estimate_group
from core.calibration.multi_view.linearisation import linearise
from core.calibration.multi_view.repeats.contrasts import PoseContrasts, common_points, pose_contrasts
from core.calibration.multi_view.repeats.image_evidence import image_p_values
from core.calibration.multi_view.repeats.noise_fields import (
    FIELDS,
    WAVELENGTHS,
    median_spacing,
    propagated_fields,
    propagated_mixture,
)
from core.calibration.multi_view.view_stack import Placements, ViewStack
from core.metrology import Verdict
from core.targets.specification import TargetSpec
from tests.support.simulation.correlated_noise import (
    DISTURBANCES,
    HEIGHT,
    Noise,
    NoisySession,
    estimated,
    figures,
    gaussian_field,
    noisy_session,
    row_wave,
    white,
)


def floor_over_reading(session: NoisySession, estimator: str = "pooled") -> float:
    """Return the mean floor of a session's poses over their mean reading, RP_l."""
    rows = figures(session, estimated(session, estimator))
    floors = [row.noise_floor.position_mm for row in rows]
    return float(np.sum(floors) / np.sum([row.repeatability.position_mm for row in rows]))


def without(views: ViewStack, missing: np.ndarray) -> ViewStack:
    """Return the views without the points that are marked."""
    kept = ~missing
    return dataclasses.replace(
        views,
        first=np.concatenate([[0], np.cumsum(views.sums(kept.astype(float)).astype(np.intp))]),
        column=views.column[kept],
        row=views.row[kept],
        points_px=np.ascontiguousarray(views.points_px[kept]),
        standard_uncertainty_px=views.standard_uncertainty_px[kept],
        points_target=views.points_target[kept],
    )


@pytest.mark.parametrize("count", [40, 600])
def test_fields_move_combinations_as_their_covariance_says(count: int) -> None:
    """Against the dense covariance, of more points than one block holds as well."""
    rng = np.random.default_rng(1)
    points = rng.uniform(0.0, 2000.0, (count, 2))
    along = rng.normal(size=(2, count, 3))
    found = propagated_fields(along, points, float(HEIGHT))
    assert found.shape == (FIELDS, 3, 3)
    square = float(np.median(KDTree(points).query(points, k=2)[0][:, 1]))
    assert median_spacing(points) == pytest.approx(square, rel=1e-12)
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    smooth = np.exp(-0.5 * (distance / (2.0 * square)) ** 2)
    rough = np.sqrt(3.0) * distance / (8.0 * square)
    wave = np.cos(2.0 * np.pi * (points[:, None, 1] - points[:, 1]) / (WAVELENGTHS[4] * HEIGHT))
    for k, kernel, components in (
        (1, smooth, (0, 1)),
        (4, (1.0 + rough) * np.exp(-rough), (0, 1)),
        (5 + 4, wave, (0,)),
        (5 + len(WAVELENGTHS) + 4, wave, (1,)),
    ):
        expected = sum(along[c].T @ kernel @ along[c] for c in components)
        assert found[k] == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())
    sizes = rng.uniform(0.0, 1.0, FIELDS)
    mixture = np.tensordot(sizes, found, axes=1)
    assert propagated_mixture(along, points, float(HEIGHT), sizes) == pytest.approx(
        mixture, rel=1e-9, abs=1e-9 * np.abs(mixture).max()
    )


def test_contrasts_are_free_of_the_robot() -> None:
    """The same noise gives the same contrasts whether the robot stood still or not, but for terms of second order."""
    found = []
    for robot_mm in (0.0, 0.05):
        s = noisy_session(np.random.default_rng(5), white(1e-2), poses=1, cycles=6)
        if robot_mm:
            moved = noisy_session(np.random.default_rng(5), white(1e-9), poses=1, cycles=6, robot_mm=robot_mm)
            still = noisy_session(np.random.default_rng(5), white(1e-9), poses=1, cycles=6)
            s = dataclasses.replace(
                s,
                views=dataclasses.replace(
                    s.views, points_px=s.views.points_px + moved.views.points_px - still.views.points_px
                ),
            )
        contrasts = contrasts_of(s)
        assert 55 <= contrasts.values.shape[1] <= 70
        found.append(contrasts)
    still_one, moving = found
    assert np.sum(moving.values**2) == pytest.approx(np.sum(still_one.values**2), rel=0.01)


def contrasts_of(s: NoisySession) -> PoseContrasts:
    """Return the contrasts of all images of a session of one pose."""
    fit = estimate_group(s.views, "given", intrinsics=s.camera, repeats=s.labels)
    rotations = np.ascontiguousarray(np.swapaxes(fit.rotations, 1, 2))
    centroids = np.einsum("kij,kj->ki", rotations, s.views.centroids - fit.positions_mm)
    used = np.ones(len(s.views.column), dtype=np.bool_)
    at = linearise(s.views, Placements(fit.cameras, rotations, centroids), used)
    contrasts = pose_contrasts(s.views, at.placements, at.residuals, used, None, np.arange(len(s.views)))
    assert contrasts is not None
    return contrasts


def test_an_image_is_as_degraded_in_every_basis_of_contrasts() -> None:
    """Equal singular values leave the basis to the library of linear algebra."""
    s = noisy_session(np.random.default_rng(3), white(), poses=1, cycles=20)
    pose = contrasts_of(s)
    pose.values[4] += np.random.default_rng(4).normal(0.0, 3.0 * pose.values.std(), pose.values.shape[1])
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(pose.values.shape[1],) * 2))[0]
    turned = dataclasses.replace(
        pose, basis=pose.basis @ turn, values=pose.values @ turn, camera=turn.T @ pose.camera
    )
    found, again = image_p_values(s.views, [pose])[:, 1], image_p_values(s.views, [turned])[:, 1]
    assert np.argmin(found) == 4
    assert found[4] < 1e-6 < np.delete(found, 4).min()
    np.testing.assert_allclose(again, found, rtol=1e-6)


def test_an_image_that_lacks_most_points_costs_the_others_none() -> None:
    s = noisy_session(np.random.default_rng(2), white(), poses=1, cycles=8)
    missing = np.zeros(len(s.views.column), dtype=np.bool_)
    missing[s.views.part(3)] = np.arange(140) >= 30
    missing[s.views.part(6)] = np.arange(140) < 5
    views = without(s.views, missing)
    used = np.ones(len(views.column), dtype=np.bool_)
    images, points = common_points(views, used, np.arange(8))
    assert images.tolist() == [0, 1, 2, 4, 5, 6, 7]
    assert points.shape == (7, 135)
    assert np.all(views.cell[points] == np.arange(5, 140))
    for i, row in zip(images.tolist(), points, strict=True):
        assert np.all((row >= views.part(i).start) & (row < views.part(i).stop))


@pytest.mark.parametrize("estimator", ["pooled", "given"])
def test_white_noise_has_the_scatter_of_white_noise(estimator: str) -> None:
    """The stated noise of white points is the simulated one: the residuals of 5 × 12 images know it to 2 %."""
    s = noisy_session(np.random.default_rng(11), white(), cycles=12)
    found = estimated(s, estimator)
    # Without repeats the noise of each image is taken for white.
    other = estimate_group(s.views, estimator, intrinsics=s.camera)
    seen, plain = (np.trace(e.scatter[:, :3, :3], axis1=1, axis2=2) for e in (found, other))
    assert np.sqrt(seen.mean() / plain.mean()) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("estimator", ["pooled_free_focal", "per_image", "per_image_fixed_pp"])
def test_images_with_lenses_of_their_own_have_the_floor_of_white_noise(estimator: str) -> None:
    s = noisy_session(np.random.default_rng(12), white(), poses=4, cycles=16)
    assert 0.75 < floor_over_reading(s, estimator) < 1.3


@pytest.mark.parametrize("noise", [gaussian_field(2.0), row_wave(0.5)], ids=["field", "wave"])
@pytest.mark.parametrize("estimator", ["pooled", "given"])
def test_a_robot_at_rest_reads_its_floor_through_correlated_noise(estimator: str, noise: Noise) -> None:
    """Five poses of thirty cycles read their expectation to some 8 %; white noise said a third to a sixth of it."""
    s = noisy_session(np.random.default_rng(4), noise)
    assert 0.7 < floor_over_reading(s, estimator) < 1.4


def test_bursts_have_the_larger_covariances() -> None:
    s = noisy_session(np.random.default_rng(8), DISTURBANCES["blur in 20 % of the images"])
    found = estimated(s)
    size = np.sqrt(np.trace(found.scatter[:, :3, :3], axis1=1, axis2=2))
    noise = np.sqrt([np.var(s.views.points_px[s.views.part(i)] - exact_mean(s, i)) for i in range(len(size))])
    assert np.corrcoef(size / np.repeat(size.reshape(5, 30).mean(axis=1), 30), noise)[0, 1] > 0.9


def exact_mean(s: NoisySession, i: int) -> np.ndarray:
    """Return the mean points of an image's pose."""
    views = s.views
    of_pose = [j for j, label in enumerate(s.labels) if label == s.labels[i]]
    return np.mean([views.points_px[views.part(j)] for j in of_pose], axis=0)


@pytest.mark.parametrize(("poses", "cycles"), [(1, 2), (2, 2), (5, 2), (1, 4), (12, 3)])
def test_few_repeats_have_a_scatter(poses: int, cycles: int) -> None:
    s = noisy_session(np.random.default_rng(poses), gaussian_field(2.0), poses=poses, cycles=cycles)
    found = estimated(s, "given")
    np.linalg.cholesky(found.scatter)
    alone = estimate_group(s.views, "given", intrinsics=s.camera)
    ratio = np.trace(found.scatter[:, :3, :3].mean(axis=0)) / np.trace(alone.scatter[:, :3, :3].mean(axis=0))
    assert 0.5 < ratio < 100.0


def test_partial_views_have_a_floor() -> None:
    """Points that are missing here and there, another set in each image."""
    s = noisy_session(np.random.default_rng(6), gaussian_field(2.0))
    missing = np.random.default_rng(7).uniform(size=len(s.views.column)) < 0.01
    partial = dataclasses.replace(s, views=without(s.views, missing))
    whole, found = floor_over_reading(s), floor_over_reading(partial)
    assert found == pytest.approx(whole, rel=0.35)


def test_two_targets_of_a_session_share_one_noise() -> None:
    """A small target has too few points for contrasts of its own, and takes the model of the other."""
    rng = np.random.default_rng(9)
    large = noisy_session(rng, gaussian_field(2.0), poses=2, cycles=10)
    target = TargetSpec("chessboard", 4, 3, 60.0)
    small = noisy_session(rng, gaussian_field(1.0), poses=2, cycles=10, target=target, camera=large.camera)
    one, two = large.views, small.views
    points = {
        name: np.concatenate([getattr(one, name), getattr(two, name)])
        for name in ("column", "row", "points_px", "standard_uncertainty_px", "points_target")
    }
    views = dataclasses.replace(
        one,
        targets=(*one.targets, target),
        target=np.concatenate([one.target, two.target + 1]),
        first=np.concatenate([one.first, one.first[-1] + two.first[1:]]),
        **points,
    )
    labels = [*large.labels, *(label + 2 for label in small.labels)]
    found = estimate_group(views, "given", intrinsics=large.camera, repeats=labels)
    np.linalg.cholesky(found.scatter)
    rows = figures(NoisySession(views, labels, large.camera), found)
    for row in rows:
        assert 0.4 < row.noise_floor.position_mm / row.repeatability.position_mm < 2.5


@pytest.mark.slow
@pytest.mark.parametrize("name", DISTURBANCES)
def test_the_floor_is_what_a_robot_at_rest_reads(name: str) -> None:
    """Six sessions of 5 × 30: their mean reading is known to 2-3 %, their mean floor to 1-4 %."""
    floors, readings = [], []
    for seed in range(6):
        s = noisy_session(np.random.default_rng([seed, 1]), DISTURBANCES[name])
        rows = figures(s, estimated(s))
        floors += [row.noise_floor.position_mm for row in rows]
        readings += [row.repeatability.position_mm for row in rows]
        assert all(row.verdict != Verdict.ROBOT for row in rows)
    assert 0.82 < sum(floors) / sum(readings) < 1.3
