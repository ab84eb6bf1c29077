"""The six estimators on the same points: found against the truth, and against what they say of themselves."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.stats import chi2

from core.calibration.multi_view.estimators import ESTIMATORS, estimate_group
from core.errors import FocalNotObservable
from core.geometry.camera import Camera, project
from core.geometry.se3 import so3_exp, transform_points
from core.targets.specification import GridPoints, TargetSpec
from tests.support.simulation.robots.resting_robot import (
    BOARD,
    HEIGHT,
    WIDTH,
    Session,
    errors,
    estimate,
    session,
    view,
)
from tests.support.simulation.simulated_views import draw_camera, draw_pose


def about_mean(s: Session, values: np.ndarray) -> np.ndarray:
    labels = np.array(s.labels)
    return np.concatenate(
        [values[labels == k] - values[labels == k].mean(axis=0) for k in sorted(set(s.labels))]
    )


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_images_of_a_resting_camera_scatter_as_stated(estimator: str) -> None:
    """Each direction of the six by itself, in units of the stated scatter: a χ² of 5 x 5 x 8 degrees of freedom."""
    ratios = []
    for seed in range(8):
        s = session(seed, tilt_deg=45.0 if estimator == "per_image" else 30.0)  # less is weak by itself
        found = estimate(s, estimator)
        assert len(found.images) == len(s.views)
        e = about_mean(s, errors(s, found))
        # Cycles of a pose have like covariances: whitened by their own, deviations from the mean lose one in six.
        whitened = np.array(
            [np.linalg.solve(np.linalg.cholesky(C), d) for C, d in zip(found.scatter, e, strict=True)]
        )
        ratios.append(np.mean(whitened**2, axis=0) * 6.0 / 5.0)
    mean = np.mean(ratios, axis=0)
    if (
        estimator == "per_image"
    ):  # the part of the valley of f, thin and across, is an upper bound for deviations
        assert mean[2] < 1.4
        mean = np.delete(mean, 2)
    # 8 sessions x 25 degrees of freedom: a standard deviation of .1.
    assert np.all(np.abs(mean - 1.0) < 0.4), mean
    assert abs(float(np.mean(mean)) - 1.0) < 0.16, mean


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["pooled", "pooled_free_focal", "given"])
def test_poses_are_off_by_what_is_stated(estimator: str) -> None:
    """The camera is drawn from the priors, so that the whole covariance has to cover the whole error."""
    squares = []
    for seed in range(40):
        s = session(100 + seed, cycles=1, tilt_deg=35.0)
        found = estimate(s, estimator)
        e = errors(s, found)
        squares.append(
            np.mean([e_i @ np.linalg.solve(C, e_i) for e_i, C in zip(e, found.covariance, strict=True)])
        )
    # Six degrees of freedom; poses of a session share the camera, so that 40 sessions count as few as 40 x 6.
    assert np.mean(squares) / 6.0 == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / 240.0))


@pytest.mark.slow
def test_regions_of_poses_by_themselves_hold_the_truth() -> None:
    """Along the valley of f, errors follow a curve; without its part the regions hold 80 % and 79 %."""
    inside = []
    for seed in range(60):
        s = session(200 + seed, cycles=1, tilt_deg=45.0)
        found = estimate(s, "per_image")
        for e, C in zip(errors(s, found), found.covariance, strict=True):
            squares = [e[:n] @ np.linalg.solve(C[:n, :n], e[:n]) for n in (3, 6)]
            inside.append(squares < chi2.ppf(0.95, [3, 6]))
    # Three binomial standard deviations of half as many: the five poses of a session share its camera.
    assert np.all(np.mean(inside, axis=0) > 0.95 - 3.0 * math.sqrt(0.95 * 0.05 / 150.0))


@pytest.mark.slow
def test_pooling_scatters_least() -> None:
    """The fewer parameters an image has to itself, the less its pose scatters."""
    s = session(3, cycles=12)
    size = {e: np.sqrt(np.trace(estimate(s, e).scatter[:, :3, :3].mean(axis=0))) for e in ESTIMATORS}
    assert size["per_image"] > 4.0 * size["per_image_fixed_pp"]
    assert size["per_image_fixed_pp"] > 2.0 * size["pooled"]
    assert size["pooled_free_focal"] > 1.5 * size["pooled"]
    assert size["pooled"] == pytest.approx(size["given"], rel=0.01)


def test_a_bowed_print_is_no_noise() -> None:
    """Residuals double; what differs between images of one pose does not."""
    flat, bowed = session(4, cycles=12), session(4, cycles=12, bow_mm=2.0)
    for estimator in ("pooled", "per_image_fixed_pp"):
        a, b = estimate(flat, estimator), estimate(bowed, estimator)
        assert b.reduced_chi2 > 3.0 * a.reduced_chi2
        first, second = (np.trace(found.scatter[:, :3, :3].mean(axis=0)) for found in (a, b))
        assert second == pytest.approx(first, rel=0.15)
        without = estimate_group(bowed.views, estimator, intrinsics=bowed.camera)
        assert np.trace(without.scatter[:, :3, :3].mean(axis=0)) > 2.0 * second


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_one_image_stored_many_times_has_a_scatter_that_is_a_number(estimator: str) -> None:
    """No noise is seen in the poses of one image alone; the others keep theirs."""
    s = session(5, poses=3, cycles=6, tilt_deg=45.0 if estimator == "per_image" else 35.0)
    copies = dataclasses.replace(s, views=[s.views[0]] * 6 + s.views[6:])
    found, plain = estimate(copies, estimator), estimate(s, estimator)
    assert np.isfinite(found.scatter).all()
    np.linalg.cholesky(found.scatter)
    of_first, of_others = (
        np.trace(found.scatter[part, :3, :3].mean(axis=0)) for part in ([0], slice(6, None))
    )
    assert of_first < 0.05 * of_others
    # With a camera each the median inflation of the images weighs the priors of all, and copies move it.
    tolerance = 0.05 if estimator.startswith("per_image") else 0.02
    assert of_others == pytest.approx(np.trace(plain.scatter[6:, :3, :3].mean(axis=0)), rel=tolerance)


def test_pooled_camera_is_the_truth_and_every_image_has_it() -> None:
    s = session(5)
    found = estimate(s, "pooled")
    u = np.sqrt(np.diag(found.camera_covariance))
    assert np.all(np.abs(found.camera.as_array() - s.camera.as_array())[:8] < 4.0 * u[:8])
    assert np.all(found.cameras == found.camera.as_array())
    assert found.disagreement == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / (8 * 30)))
    assert found.reduced_chi2 == pytest.approx(1.0, abs=0.1)


def test_pooling_starts_far_from_the_truth() -> None:
    """Near fronto-parallel views give no start of their own; a few tilted ones fix all."""
    rng = np.random.default_rng(8)
    camera = Camera(5200.0, 5201.0, 1230.0, 1020.0, -0.1, 0.05)
    tilts = [0.5, 0.5, 0.5, 1.0, 1.0, 25.0, 30.0, 35.0]
    poses = [draw_pose(rng, BOARD, camera, WIDTH, math.radians(t)) for t in tilts]
    found = estimate_group([view(rng, camera, T) for T in poses], "pooled")
    assert list(found.images) == list(range(8))
    assert abs(found.camera.fx_px - camera.fx_px) < 4.0 * math.sqrt(found.camera_covariance[0, 0])
    free = estimate_group([view(rng, camera, T) for T in poses], "per_image")
    assert {i for i, failure in free.failures if isinstance(failure, FocalNotObservable)} >= {0, 1, 2}


@pytest.mark.parametrize("estimator", ["pooled", "given"])
def test_gross_errors_are_rejected(estimator: str) -> None:
    s = session(6, cycles=3)
    rng = np.random.default_rng(1)
    spoiled = list(s.views)
    for i in (0, 4, 7):
        pixels = s.views[i].points_px.copy()
        pixels[rng.choice(140, 20, replace=False)] += rng.normal(0.0, 20.0, (20, 2))
        spoiled[i] = dataclasses.replace(s.views[i], points_px=pixels)
    # One view is of nothing that is there: its columns run the wrong way.
    mirrored = s.views[9].points_px.reshape(10, 14, 2)[:, ::-1].reshape(-1, 2)
    spoiled[9] = dataclasses.replace(s.views[9], points_px=mirrored + rng.normal(0.0, 3.0, mirrored.shape))
    found = estimate_group(spoiled, estimator, intrinsics=s.camera)
    assert [i for i, _ in found.failures] == [9]
    e = errors(s, found)
    assert np.sqrt(np.mean(np.sum(e[:, :3] ** 2, axis=1))) < 0.05
    assert np.max(np.abs(found.camera.as_array() - s.camera.as_array())[:2]) < 0.5


def test_a_changed_focal_length_contradicts_a_common_camera() -> None:
    s = session(7)
    centre = np.array([s.camera.cx_px, s.camera.cy_px])
    breathing = [
        dataclasses.replace(v, points_px=(v.points_px - centre) * (1.0 + 2e-3 * (i % 2)) + centre)
        for i, v in enumerate(s.views)
    ]
    chance = 1.0 + 4.0 * math.sqrt(2.0 / (8 * 30))
    tied = estimate_group(breathing, "pooled", repeats=s.labels)
    free = estimate_group(breathing, "pooled_free_focal", repeats=s.labels)
    assert tied.disagreement is not None
    assert free.disagreement is not None
    assert tied.disagreement > 5.0
    assert tied.unsteady.all()
    steady = estimate_group(s.views, "pooled", repeats=s.labels)
    assert not steady.unsteady.any()
    assert free.disagreement < chance
    assert free.cameras[1::2, 0].mean() / free.cameras[::2, 0].mean() == pytest.approx(1.002, abs=2e-4)


@pytest.mark.parametrize("missing", [False, True])
def test_what_is_wrong_in_the_same_way_in_all_images_is_no_change_of_the_camera(missing: bool) -> None:
    """A bowed print, and given intrinsics off by ten pixels, before a robot that moves; and points hidden here and
    there. A focus that breathes is detected through all that."""
    rng = np.random.default_rng(3)
    camera = draw_camera(rng)
    views, breathing, labels = [], [], []
    for pose in range(5):
        T = draw_pose(rng, BOARD, camera, WIDTH, math.radians(30.0))
        for cycle in range(10):
            moved = T.copy()
            moved[:3, 3] += rng.normal(0.0, 0.1, 3)
            seen = view(rng, camera, moved, sigma_px=0.02, bow_mm=0.1)
            keep = np.ones(len(seen), dtype=bool)
            keep[rng.integers(len(seen))] = not missing
            seen = dataclasses.replace(
                seen,
                **{
                    name: getattr(seen, name)[keep]
                    for name in ("column", "row", "points_px", "standard_uncertainty_px")
                },
            )
            views.append(seen)
            centre = np.array([camera.cx_px, camera.cy_px])
            grown = (seen.points_px - centre) * (1.0 + 2e-3 * (cycle % 2)) + centre
            breathing.append(dataclasses.replace(seen, points_px=grown))
            labels.append(pose)
    off = dataclasses.replace(camera, cx_px=camera.cx_px + 10.0)
    assert not estimate_group(views, "pooled", repeats=labels).unsteady.any()
    assert not estimate_group(views, "given", intrinsics=off, repeats=labels).unsteady.any()
    assert estimate_group(breathing, "pooled", repeats=labels).unsteady.all()


def test_the_print_scale_is_in_the_pose_and_not_in_the_scatter() -> None:
    s = session(9, cycles=2)
    uncertain = dataclasses.replace(BOARD, pitch_standard_uncertainty_mm=0.01)
    plain = estimate(s, "pooled")
    scaled = estimate_group(
        [dataclasses.replace(v, target=uncertain) for v in s.views], "pooled", repeats=s.labels
    )
    np.testing.assert_array_equal(plain.positions_mm, scaled.positions_mm)
    np.testing.assert_array_equal(plain.scatter, scaled.scatter)
    expected = 1e-6 * np.einsum("ki,kj->kij", plain.positions_mm, plain.positions_mm)
    np.testing.assert_allclose((scaled.covariance - plain.covariance)[:, :3, :3], expected, atol=1e-9)


def test_two_boards_before_one_camera_are_pooled() -> None:
    rng = np.random.default_rng(12)
    camera = draw_camera(rng)
    other = TargetSpec("chessboard", 9, 6, 12.0)
    poses = [draw_pose(rng, BOARD, camera, WIDTH, math.radians(30)) for _ in range(4)]
    first = [view(rng, camera, T) for T in poses]
    second = []
    for T in poses:
        turned = T.copy()
        turned[:3, :3] = turned[:3, :3] @ so3_exp(np.array([0.0, 0.0, 0.4]))
        pixels = project(transform_points(turned, other.points_target()), camera)
        row, column = (a.ravel() for a in np.mgrid[0:6, 0:9])
        noisy = pixels + rng.normal(0.0, 0.05, pixels.shape)
        second.append(GridPoints(other, WIDTH, HEIGHT, column, row, noisy, np.full(54, 0.05)))
    found = estimate_group([*first, *second], "pooled")
    assert len(found.images) == 8
    assert abs(found.camera.fx_px - camera.fx_px) < 4.0 * math.sqrt(found.camera_covariance[0, 0])


@pytest.mark.parametrize("estimator", ["pooled", "given"])
def test_where_a_view_starts_does_not_matter(estimator: str) -> None:
    """Views of one label start from one placement; with wrong labels, from where the homography puts them."""
    s = session(14, poses=4, cycles=60)
    together = estimate(s, estimator)
    apart = estimate_group(s.views, estimator, intrinsics=s.camera)
    mistaken = estimate_group(s.views, estimator, intrinsics=s.camera, repeats=[0] * len(s.views))
    u = np.sqrt(np.einsum("kii->ki", together.scatter))[:, :3]
    for other in (apart, mistaken):
        assert len(other.images) == len(s.views)
        assert np.max(np.abs(other.positions_mm - together.positions_mm) / u) < 0.05
