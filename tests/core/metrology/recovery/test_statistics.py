"""Monte Carlo: do the intervals cover, the floors predict the expected reading, and the subtraction find the robot?

Truth is Gaussian scatter of known covariance seen through Gaussian measurement noise. Spheres, flats, needles and
what lies between; noise of the same and of another shape. Each trial is one pose of n cycles.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry.roll_pitch_yaw import rotation_to_rpy, rpy_to_rotation
from core.geometry.se3 import so3_exp
from core.metrology import PoseCycles, assess_repeatability
from core.metrology.repeatability.intervals import (
    MAX_FLOOR_SHARE,
)
from core.metrology.rp_distribution import eigenvalues, long_run_rp, rp_sampling_distribution
from tests.support.metrology.scatter_trials import SHAPES, covered, of_reading, run


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 30, 100])
@pytest.mark.parametrize("shape", SHAPES)
def test_intervals_of_position_repeatability_cover_95_percent_within_2(n: int, shape: str) -> None:
    # 6,000 trials know a coverage to .28 %.
    trials = 6000
    rng = np.random.default_rng([1, n])
    spectrum = np.array(SHAPES[shape])
    d = rng.standard_normal((trials, n, 3)) * np.sqrt(spectrum)
    d -= d.mean(axis=1, keepdims=True)
    lengths = np.linalg.norm(d, axis=2)
    reading = lengths.mean(axis=1) + 3.0 * lengths.std(axis=1, ddof=1)
    spectra = eigenvalues(d.transpose(0, 2, 1) @ d / (n - 1))
    low, high = rp_sampling_distribution(spectra, np.full(trials, float(n))).interval(reading)
    truth = float(long_run_rp(spectrum))
    assert covered(low, high, truth) == pytest.approx(0.95, abs=0.02)
    # Neither end does the other's work: 2.5 % each, within 1.5.
    assert np.mean(truth < low) < 0.04
    assert np.mean(truth > high) < 0.04


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 30, 100])
@pytest.mark.parametrize("noise_shape", ["sphere", "needle"])
def test_intervals_of_three_sigma_cover_exactly(n: int, noise_shape: str) -> None:
    trials = 4000
    robot, noise = of_reading("egg", 2.0), of_reading(noise_shape, 1.0)
    result = run(n, robot, noise, trials, seed=2, radial_of=1)
    error = 4.0 * math.sqrt(0.95 * 0.05 / trials)
    for axis in range(3):
        raw = 3.0 * math.sqrt(robot[axis] + noise[axis])
        said = result.three_sigma
        assert covered(said.low[:, axis], said.high[:, axis], raw) == pytest.approx(0.95, abs=error)
        alone = 3.0 * math.sqrt(robot[axis])
        inside = covered(said.corrected_low[:, axis], said.corrected_high[:, axis], alone)
        assert inside == pytest.approx(0.95, abs=error)


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 30])
@pytest.mark.parametrize("shape", ["sphere", "flat", "needle"])
def test_intervals_cover_where_cycles_differ_in_noise(n: int, shape: str) -> None:
    # Every other measurement has three times the variance of the rest; robot and instrument read the same.
    robot, noise = of_reading(shape, 1.0), of_reading("sphere", 1.0)
    weights = np.where(np.arange(n) % 2, 0.5, 1.5)
    # 3,000 trials know a coverage to .4 %: the tolerances are five and six times as wide.
    result = run(n, robot, noise, 3000, seed=3, weights=weights)
    x = 3.0 * math.sqrt(robot[0] + noise[0])
    assert covered(result.three_sigma.low[:, 0], result.three_sigma.high[:, 0], x) == pytest.approx(
        0.95, abs=0.02
    )
    # The long run of such a mixture, by simulation with 600,000 cycles (known to .2 %).
    rng = np.random.default_rng(33)
    scatter = np.sqrt(robot + noise * np.tile([1.5, 0.5], 300_000)[:, None])
    lengths = np.linalg.norm(rng.standard_normal((600_000, 3)) * scatter, axis=1)
    truth = float(lengths.mean() + 3.0 * lengths.std())
    assert covered(result.radial.low, result.radial.high, truth) == pytest.approx(0.95, abs=0.025)


@pytest.mark.slow
@pytest.mark.parametrize("n", [10, 30, 100])
@pytest.mark.parametrize("ratio", [2.2, 5.0])
@pytest.mark.parametrize(
    ("shape", "noise_shape", "turned"),
    [
        ("sphere", "sphere", False),
        ("egg", "needle", True),
        ("flat", "sphere", False),
        ("needle", "needle", False),
    ],
)
def test_corrected_intervals_of_position_cover_where_the_floor_is_low(
    n: int, ratio: float, shape: str, noise_shape: str, turned: bool
) -> None:
    robot, noise = of_reading(shape, ratio), of_reading(noise_shape, 1.0, turned)
    result = run(n, robot, noise, 2000, seed=6)
    inside = covered(result.radial.corrected_low, result.radial.corrected_high, ratio)
    # 2,000 trials know it to √(.95 · .05 / 2000) = .49 %: four standard errors.
    assert inside == pytest.approx(0.95, abs=0.02)
    # What is withheld because the floor looks high would have missed more often than what is given.
    given = result.radial.floor <= MAX_FLOOR_SHARE * result.reading
    assert given.mean() > 0.7
    stated = covered(result.radial.corrected_low[given], result.radial.corrected_high[given], ratio)
    assert stated > 0.93


@pytest.mark.slow
def test_six_dimensional_poses_through_the_door() -> None:
    # 1,200 poses of 12 cycles, position and orientation correlated in robot and instrument, at a pitch of 50°.
    trials, n = 1200, 12
    rng = np.random.default_rng(7)
    robot_root = rng.normal(size=(6, 6)) * np.array([0.02] * 3 + [1.5e-4] * 3)[:, None]
    noise_root = rng.normal(size=(6, 6)) * np.array([0.008] * 3 + [6e-5] * 3)[:, None]
    robot, noise = robot_root @ robot_root.T, noise_root @ noise_root.T
    mean = rpy_to_rotation(np.array([0.3, math.radians(50.0), -2.5]))
    poses = []
    for _ in range(trials):
        draws = rng.normal(size=(n, 6)) @ robot_root.T + rng.normal(size=(n, 6)) @ noise_root.T
        rotations = np.array([so3_exp(w) @ mean for w in draws[:, 3:]])
        poses.append(PoseCycles(draws[:, :3], rotations, np.repeat(noise[None], n, axis=0)))
    results = assess_repeatability(poses)
    # d(roll, pitch, yaw)/dw at the mean, by differences of the angles themselves
    step = 1e-6
    columns = [(rotation_to_rpy(so3_exp(step * e) @ mean) - rotation_to_rpy(mean)) / step for e in np.eye(3)]
    J = np.eye(6)
    J[3:, 3:] = np.array(columns).T
    total = J @ (robot + noise) @ J.T
    truth = {"position_mm": float(long_run_rp(eigenvalues(total[:3, :3])))} | {
        name: 3.0 * math.sqrt(total[k, k])
        for k, name in enumerate(("x_mm", "y_mm", "z_mm", "roll", "pitch", "yaw"))
    }
    for name, value in truth.items():
        bounds = np.array([getattr(r.interval, name) for r in results])
        # 1,200 trials know it to .63 %
        assert covered(bounds[:, 0], bounds[:, 1], value) == pytest.approx(0.95, abs=0.025), name
    alone = J @ robot @ J.T
    c4 = 0.9776  # of twelve cycles
    for k, name in enumerate(("x_mm", "y_mm", "z_mm", "roll", "pitch", "yaw")):
        corrected = np.array([getattr(r.corrected, name) for r in results])
        expected = 3.0 * c4 * math.sqrt(alone[k, k])
        error = 4.0 * corrected.std() / math.sqrt(trials)
        assert corrected.mean() == pytest.approx(expected, abs=0.01 * expected + error), name
