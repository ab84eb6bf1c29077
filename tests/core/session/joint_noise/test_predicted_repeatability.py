"""Predicted repeatability is the simulated one at poses never measured, and the map's worst place is its worst."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.kinematics import fit_joint_noise, gather_scatters
from core.metrology import position_repeatability
from core.session.joint_noise import NORMAL_FACTOR, map_repeatability, predict_scatter, validate_joint_noise
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, KR5_ARC_LIMITS
from tests.support.simulation.robots.repeated_poses import JOINT_SIGMA, camera_poses, repeated_poses


def test_rp_is_predicted_at_poses_that_were_never_measured() -> None:
    arm, data, _ = repeated_poses(11)
    seen = gather_scatters(data, KR5_ARC)
    noise = fit_joint_noise(seen)
    rng = np.random.default_rng(1)
    q = KR5_ARC_HOME + rng.uniform(-1.0, 1.0, (8, 6))
    found = predict_scatter(noise, seen.arm, q)
    true = np.empty(len(q))
    for i, angles in enumerate(q):
        T = camera_poses(arm, angles + rng.normal(size=(4000, 6)) * JOINT_SIGMA)
        true[i] = position_repeatability(T[:, :3, 3])
        shape = np.cov(T[:, :3, 3], rowvar=False)
        np.testing.assert_allclose(found.covariance_mm2[i], shape, atol=0.35 * np.trace(shape))
    assert np.ptp(true) > 0.3 * true.mean()  # places differ
    np.testing.assert_allclose(found.rp_l_mm, true, rtol=0.15)
    # Uncertainties are of the size of the errors: all eight share the same noise.
    z = (found.rp_l_mm - true) / found.standard_uncertainty_mm
    assert np.sqrt(np.mean(z**2)) < 2.5
    assert np.all(found.standard_uncertainty_mm < 0.1 * found.rp_l_mm)
    low, high = found.interval()
    assert np.all((low < found.rp_l_mm) & (found.rp_l_mm < high))
    assert np.all(found.joint_share > 0.95)


@pytest.mark.slow
def test_intervals_of_predicted_rp_hold_the_truth() -> None:
    inside, of_joints, errors = [], [], []
    runs, places = 100, 10
    for seed in range(runs):
        _, data, _ = repeated_poses(1000 + seed, poses=10, visits=10)
        seen = gather_scatters(data, KR5_ARC)
        noise = fit_joint_noise(seen)
        q = KR5_ARC_HOME + np.random.default_rng(seed).uniform(-1.0, 1.0, (places, 6))
        found = predict_scatter(noise, seen.arm, q)
        true = replace(noise, variances=np.concatenate([JOINT_SIGMA**2, [0.0, 0.0]]))
        rp = predict_scatter(true, seen.arm, q).rp_l_mm
        low, high = found.interval()
        inside.append(np.mean((low <= rp) & (rp <= high)))
        bounds = noise.interval(NORMAL_FACTOR)
        of_joints.append(np.mean((bounds[0][:6] <= JOINT_SIGMA) & (bounds[1][:6] >= JOINT_SIGMA)))
        errors.append(np.mean((found.rp_l_mm / rp - 1.0) ** 2))
    figures = np.mean(of_joints), np.mean(inside), math.sqrt(float(np.mean(errors)))
    print("intervals hold: joints {:.3f}, RP_l {:.3f}; relative error of RP_l {:.3f}".format(*figures))
    # Ten places of a session share one noise: as few as one independent interval in each.
    assert abs(figures[0] - 0.95) < 3.0 * math.sqrt(0.95 * 0.05 / (6 * runs)) + 0.01
    assert abs(figures[1] - 0.95) < 3.0 * math.sqrt(0.95 * 0.05 / runs)
    assert figures[2] < 0.08


def test_held_out_poses_scatter_as_predicted_and_not_as_one_ellipsoid_says() -> None:
    _, data, _ = repeated_poses(12)
    seen = gather_scatters(data, KR5_ARC)
    held_out = validate_joint_noise(seen, fit_joint_noise(seen))
    assert held_out.supported
    assert held_out.log_likelihood_gain > 100.0
    assert held_out.chi_ratio == pytest.approx(1.0, abs=0.06)
    assert held_out.rp_log_rms < 1.5 * held_out.rp_log_expected
    assert held_out.rp_log_rms < held_out.constant_rp_log_rms


def test_a_pose_of_two_visits_that_disagree_is_not_held_against_the_prediction() -> None:
    _, data, _ = repeated_poses(19, poses=40, visits=2)
    positions = data.positions_mm.copy()
    positions[11] += [2.0, -2.0, 1.0]
    seen = gather_scatters(replace(data, positions_mm=positions), KR5_ARC)
    held_out = validate_joint_noise(seen, fit_joint_noise(seen))
    assert np.flatnonzero(np.isnan(held_out.rp_ratio)).tolist() == [5]
    assert held_out.chi_ratio == pytest.approx(1.0, abs=0.2)  # 39 pairs of six components: 6.5 %, three times
    assert held_out.rp_log_rms < 1.5 * held_out.rp_log_expected


def test_scatter_that_no_joint_makes_is_not_said_to_come_from_joints() -> None:
    _, data, _ = repeated_poses(13, joint_sigma=np.zeros(6), remaining_mm=0.05)
    seen = gather_scatters(data, KR5_ARC)
    noise = fit_joint_noise(seen)
    held_out = validate_joint_noise(seen, noise)
    assert held_out.log_likelihood_gain < 30.0
    assert np.all(predict_scatter(noise, seen.arm, seen.joint_angles).joint_share < 0.2)


@pytest.mark.parametrize(("share", "stated"), [(0.0, 1.0), (0.1, 1.3), (0.1, 25.0)])
def test_noise_that_is_not_seen_has_bounds_of_the_size_of_the_instrument_s(
    share: float, stated: float
) -> None:
    """A robot that scatters less than the instrument, of which more or less is stated than shows: in most sessions of
    the second kind no variance is above zero, and there was no answer; of the first, bounds of metres."""
    for seed in range(6):
        _, data, _ = repeated_poses(2000 + seed, poses=10, visits=5, joint_sigma=share * JOINT_SIGMA)
        assert data.covariance is not None
        seen = gather_scatters(replace(data, covariance=stated * data.covariance), KR5_ARC)
        noise = fit_joint_noise(seen)
        validate_joint_noise(seen, noise)
        found = predict_scatter(noise, seen.arm, KR5_ARC_HOME[None])
        true = replace(noise, variances=np.concatenate([(share * JOINT_SIGMA) ** 2, [0.0, 0.0]]))
        low, high = found.interval()
        instrument = 3.6 * 0.01 * math.sqrt(stated)  # RP_l of a sphere of its standard deviation
        assert low[0] <= found.rp_l_mm[0] <= high[0] < 3.0 * instrument
        assert found.standard_uncertainty_mm[0] < 1.5 * instrument
        assert predict_scatter(true, seen.arm, KR5_ARC_HOME[None]).rp_l_mm[0] <= high[0]


@cache
def supported_by_chance(poses: int, visits: int, seed: int) -> list[bool]:
    """Return whether joints are supported that do not scatter, of either shape of the scatter that there is."""
    _, data, _ = repeated_poses(
        9000 + seed, poses=poses, visits=visits, joint_sigma=np.zeros(6), remaining_mm=0.02
    )
    rng = np.random.default_rng(seed)
    long = rng.normal(size=(len(data.positions_mm), 1)) * rng.normal(size=3) * 0.05
    found = []
    for positions in (data.positions_mm, data.positions_mm + long):
        seen = gather_scatters(replace(data, positions_mm=positions), KR5_ARC)
        found.append(validate_joint_noise(seen, fit_joint_noise(seen)).supported)
    return found


@pytest.mark.parametrize(
    ("poses", "visits", "seeds"),
    [
        (10, 10, 15),
        pytest.param(10, 10, 40, marks=pytest.mark.slow),
        pytest.param(6, 5, 120, marks=pytest.mark.slow),
    ],
)
def test_joints_are_supported_by_chance_in_at_most_one_session_of_twenty(
    poses: int, visits: int, seeds: int
) -> None:
    """No joint scatters: equal in all directions, and one ellipsoid for all poses."""
    supported = np.sum([supported_by_chance(poses, visits, seed) for seed in range(seeds)], axis=0)
    print(f"{poses} poses x {visits} visits: supported without joint noise {supported / seeds}")
    assert np.all(supported <= 0.05 * seeds + 2.5 * math.sqrt(0.05 * 0.95 * seeds))


def test_joint_noise_is_supported_by_six_poses_of_five_visits() -> None:
    runs = 20
    found = 0
    for seed in range(runs):
        seen = gather_scatters(repeated_poses(9500 + seed, poses=6, visits=5)[1], KR5_ARC)
        found += validate_joint_noise(seen, fit_joint_noise(seen)).supported
    assert found >= 0.8 * runs


def test_the_worst_place_is_the_maps_largest_and_within_the_limits() -> None:
    _, data, _ = repeated_poses(14, poses=6, visits=10)
    seen = gather_scatters(data, KR5_ARC)
    noise = fit_joint_noise(seen)
    limits = (
        np.asarray(KR5_ARC_LIMITS).T if np.shape(KR5_ARC_LIMITS) == (6, 2) else np.asarray(KR5_ARC_LIMITS)
    )
    found = map_repeatability(noise, seen.arm, limits, samples=2000)
    assert np.all((limits[0] <= found.worst_joint_angles) & (found.worst_joint_angles <= limits[1]))
    worst = float(found.worst.rp_l_mm[0])
    assert worst >= max(cell.largest_rp_l_mm for cell in found.cells)
    for cell in found.cells:
        assert cell.least_rp_l_mm <= cell.median_rp_l_mm <= cell.largest_rp_l_mm <= worst
    assert sum(cell.configurations for cell in found.cells) <= 2000
    assert len(found.cells) > 50
    # A stretched arm is worse than a folded one: the first joint's noise grows with the radius.
    near = [c.median_rp_l_mm for c in found.cells if c.radius_mm < 400.0]
    far = [c.median_rp_l_mm for c in found.cells if c.radius_mm > 1200.0]
    assert np.median(far) > np.median(near)
    radius = math.hypot(*found.worst_position_mm[:2])
    assert radius < sum(abs(j.a_mm) + abs(j.d_mm) for j in KR5_ARC.joints) + 500.0
    with pytest.raises(InvalidArgument):
        map_repeatability(noise, seen.arm, limits[::-1])
