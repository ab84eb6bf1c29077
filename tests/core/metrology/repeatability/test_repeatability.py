"""Whole poses: what the service shows, and what happens to cycles that cannot be used."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.geometry.roll_pitch_yaw import rpy_to_rotation
from core.metrology import COMPONENTS, PoseCycles, Verdict, assess_repeatability
from tests.support.metrology.assessments import assess, numbers


def test_a_good_session_measures_the_robot(make_cycles: Any) -> None:
    result = assess(make_cycles(noise_mm=0.002, noise_rad=1e-5))
    assert result.n == 30
    assert result.verdict == "robot"
    assert [verdict for _, verdict in result.verdicts.items()] == ["robot"] * 7
    assert result.warnings == ()
    assert (result.n, result.outliers) == (30, ())
    for (name, reading), (_, floor), (_, corrected), (_, interval) in zip(
        result.repeatability.items(),
        result.noise_floor.items(),
        result.corrected.items(),
        result.interval.items(),
        strict=True,
    ):
        assert reading is not None, name
        assert floor is not None
        assert corrected is not None
        assert interval is not None
        assert 0.0 < floor < 0.25 * reading
        assert 0.95 * reading < corrected < reading
        assert interval[0] < reading < interval[1]


def test_names_are_the_contracts() -> None:
    assert COMPONENTS == ("position_mm", "x_mm", "y_mm", "z_mm", "roll", "pitch", "yaw")


def test_a_motionless_robot_reads_its_floor(make_cycles: Any) -> None:
    results = assess_repeatability([make_cycles(robot_mm=0.0, robot_rad=0.0, seed=s) for s in range(200)])
    for name in COMPONENTS:
        readings = np.array([getattr(r.repeatability, name) for r in results])
        floor = getattr(results[0].noise_floor, name)
        assert floor == pytest.approx(readings.mean(), abs=4.0 * readings.std() / math.sqrt(len(readings)))
    assert {r.verdict for r in results} <= {Verdict.INSTRUMENT_LIMITED, Verdict.BELOW_DETECTION}


def test_noise_that_is_overstated_is_below_detection(make_cycles: Any) -> None:
    cycles = make_cycles(robot_mm=0.0, robot_rad=0.0)
    overstated = PoseCycles(cycles.positions_mm, cycles.rotations, 4.0 * cycles.covariances)
    assert assess(overstated).verdict == "below_detection"


def test_nine_cycles_are_too_few_and_the_figures_stand(make_cycles: Any) -> None:
    result = assess(make_cycles(n=9))
    assert result.verdict == "too_few_cycles"
    assert len(numbers(result)) == 3 * 7 + 2 * 14


def test_one_cycle_has_a_mean_and_no_figures(make_cycles: Any) -> None:
    result = assess(make_cycles(n=1))
    assert result.verdict == "too_few_cycles"
    assert numbers(result) == []
    assert result.orientation is None
    assert result.mean_roll_pitch_yaw is not None
    np.testing.assert_allclose(result.mean_position_mm, [400.0, -250.0, 900.0], atol=1.0)


@pytest.mark.parametrize("n", [2, 3, 4, 10, 101, 2000])
def test_figures_are_finite_for_every_number_of_cycles(make_cycles: Any, n: int) -> None:
    values = numbers(assess(make_cycles(n=n)))
    assert np.isfinite(values).all()
    assert min(values) >= 0.0


def test_positions_alone_give_position_figures(make_cycles: Any) -> None:
    cycles = make_cycles()
    result = assess(PoseCycles(cycles.positions_mm, None, cycles.covariances))
    assert result.repeatability.position_mm == assess(cycles).repeatability.position_mm
    assert result.repeatability.roll is result.interval.yaw is result.verdicts.pitch is None
    assert result.mean_roll_pitch_yaw is None


def test_without_covariances_the_instrument_is_unknown_and_that_is_said(make_cycles: Any) -> None:
    cycles = make_cycles()
    result = assess(PoseCycles(cycles.positions_mm, cycles.rotations))
    assert [warning.code for warning in result.warnings] == ["noise_unknown"]
    assert result.verdict == "instrument_limited"  # a check that cannot be made does not pass
    assert [verdict for _, verdict in result.verdicts.items()] == ["instrument_limited"] * 7
    # An unknown share of the instrument is not subtracted, nor called zero.
    for figures in (result.noise_floor, result.corrected, result.corrected_interval):
        assert {value for _, value in figures.items()} == {None}
    assert result.interval.position_mm is not None


def test_identical_cycles_read_zero_and_say_so(make_cycles: Any) -> None:
    one = make_cycles(n=1)
    cycles = PoseCycles(
        np.repeat(one.positions_mm, 30, axis=0),
        np.repeat(one.rotations, 30, axis=0),
        np.repeat(one.covariances, 30, axis=0),
    )
    result = assess(cycles)
    assert result.repeatability.position_mm == 0.0
    assert result.corrected.position_mm is None  # of nothing that scatters is anything known
    assert result.verdict == "below_detection"
    assert [warning.code for warning in result.warnings] == ["no_scatter"]
    assert np.isfinite(numbers(result)).all()


@pytest.mark.parametrize("pitch_deg", [90.0, -90.0, 89.9999, 86.0, -85.5])
def test_gimbal_lock_warns_and_breaks_nothing(make_cycles: Any, pitch_deg: float) -> None:
    cycles = make_cycles(roll_pitch_yaw=(0.2, math.radians(pitch_deg), 0.5))
    result = assess(cycles)
    assert [warning.code for warning in result.warnings] == ["near_gimbal_lock"]
    assert np.isfinite(numbers(result)).all()
    # 3 √(π²/3): an angle of which nothing is known
    assert max(numbers(result)) < math.sqrt(3.0) * math.pi * (1.0 + 1e-12)
    upright = assess(make_cycles(roll_pitch_yaw=(0.0, 0.0, 0.0)))
    assert result.orientation is not None
    assert upright.orientation is not None
    np.testing.assert_allclose(result.orientation.vector_xyz, upright.orientation.vector_xyz, rtol=1e-6)


def test_no_warning_six_degrees_from_the_singularity(make_cycles: Any) -> None:
    assert assess(make_cycles(roll_pitch_yaw=(0.2, math.radians(84.0), 0.5))).warnings == ()


def test_angles_by_the_standard_agree_with_the_mapped_vectors(make_cycles: Any) -> None:
    result = assess(make_cycles())
    mapped = (result.repeatability.roll, result.repeatability.pitch, result.repeatability.yaw)
    assert result.orientation is not None
    assert result.orientation.roll_pitch_yaw == pytest.approx(mapped, rel=1e-3)


def test_yaw_about_half_a_turn_does_not_jump(make_cycles: Any) -> None:
    result = assess(make_cycles(roll_pitch_yaw=(math.pi, 0.0, math.pi)))
    assert result.orientation is not None
    assert max(result.orientation.roll_pitch_yaw) < 1e-3


@pytest.mark.parametrize("n", [2, 3, 5, 30])
def test_no_corrected_bound_exceeds_the_raw_one(n: int) -> None:
    rng = np.random.default_rng(n)
    covariances = np.tile(np.diag([0.003**2] * 3 + [1e-10] * 3), (n, 1, 1))
    poses = [
        PoseCycles(rng.normal(0.0, 0.02, (n, 3)), np.tile(np.eye(3), (n, 1, 1)), covariances)
        for _ in range(20)
    ]
    for found in assess_repeatability(poses):
        for (_, raw), (_, corrected) in zip(
            found.interval.items(), found.corrected_interval.items(), strict=True
        ):
            if raw is None or corrected is None:
                continue  # orientations that do not scatter
            assert corrected[0] <= raw[0]
            assert corrected[1] <= raw[1]


def test_a_pose_reads_the_same_alone_and_in_company(make_cycles: Any) -> None:
    poses = [make_cycles(n=n, seed=n) for n in (2, 29, 30, 30, 31, 9, 1)]
    together = assess_repeatability(poses)
    for alone, among_others in zip((assess(p) for p in poses), together, strict=True):
        for field in dataclasses.fields(alone):
            a, b = getattr(alone, field.name), getattr(among_others, field.name)
            assert np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b, field.name


def test_no_poses_give_no_figures() -> None:
    assert assess_repeatability([]) == []


def bad_covariance(index: int, value: np.ndarray) -> np.ndarray:
    covariances = np.repeat(1e-6 * np.eye(6)[None], 3, axis=0)
    covariances[index] = value
    return covariances


TURNED = rpy_to_rotation(np.array([0.1, 0.2, 0.3]))


@pytest.mark.parametrize(
    ("positions", "rotations", "covariances", "message"),
    [
        (np.zeros((0, 3)), None, None, "at least one cycle"),
        (np.array([[0.0, 0.0, 0.0], [0.0, np.nan, 0.0]]), None, None, "Cycle 2 has a position"),
        (np.array([[np.inf, 0.0, 0.0]]), None, None, "Cycle 1 has a position"),
        (
            np.array([[0.0, 0.0, 0.0], [0.0, -1e150, 0.0]]),
            None,
            None,
            "Cycle 2 has a position more than 1e\\+09 mm",
        ),
        (
            np.zeros((3, 3)),
            None,
            bad_covariance(1, 1e19 * np.eye(6)),
            "Cycle 2 has a standard uncertainty above",
        ),
        (
            np.zeros((3, 3)),
            None,
            bad_covariance(2, np.diag([0.0, 0.0, 0.0, 0.0, 1e7, 0.0])),
            "Cycle 3 has a standard uncertainty above",
        ),
        (
            np.zeros((2, 3)),
            np.stack([TURNED, 1.01 * TURNED]),
            None,
            "Cycle 2 has a matrix that is no rotation",
        ),
        (np.zeros((1, 3)), np.diag([1.0, 1.0, -1.0])[None], None, "Cycle 1 has a matrix that is no rotation"),
        (np.zeros((1, 3)), np.full((1, 3, 3), np.nan), None, "Cycle 1 has a rotation that is not finite"),
        (np.zeros((2, 3)), TURNED[None], None, "2 positions and 1 rotations"),
        (np.zeros((3, 3)), None, bad_covariance(1, -np.eye(6)), "Cycle 2 has a covariance"),
        (np.zeros((3, 3)), None, bad_covariance(2, np.full((6, 6), np.nan)), "Cycle 3 has a covariance"),
        (np.zeros((3, 3)), None, bad_covariance(0, np.triu(np.ones((6, 6)))), "Cycle 1 has a covariance"),
        (
            np.zeros((3, 3)),
            None,
            bad_covariance(0, np.eye(6) + 2.0 * np.eye(6)[::-1]),
            "Cycle 1 has a covariance that is not symmetric positive semidefinite",
        ),
        (np.zeros((2, 3)), None, np.zeros((3, 6, 6)), "2 positions and 3 covariances"),
    ],
)
def test_input_that_cannot_be_used_is_named(
    positions: np.ndarray, rotations: np.ndarray | None, covariances: np.ndarray | None, message: str
) -> None:
    with pytest.raises(InvalidArgument, match=message) as failure:
        PoseCycles(positions, rotations, covariances)
    assert failure.value.advice


def test_a_singular_covariance_is_fine() -> None:
    covariance = np.diag([1e-6, 0.0, 1e-6, 0.0, 1e-10, 1e-10])
    result = assess(
        PoseCycles(
            np.random.default_rng(0).normal(scale=0.01, size=(30, 3)),
            np.repeat(TURNED[None], 30, axis=0),
            np.repeat(covariance[None], 30, axis=0),
        )
    )
    assert result.noise_floor.y_mm == 0.0
    assert np.isfinite(numbers(result)).all()


@pytest.mark.parametrize("n", [2, 3, 30])
@pytest.mark.parametrize("spread_mm", [1e9, 1e3, 1e-9, 1e-120, 1e-310])
@pytest.mark.parametrize("noise_mm", [1e9, 1.0, 1e-80, 0.0])
def test_figures_are_finite_at_the_ends_of_what_is_taken(n: int, spread_mm: float, noise_mm: float) -> None:
    rng = np.random.default_rng(n)
    positions = np.clip(spread_mm * rng.standard_normal((n, 3)), -1e9, 1e9)
    covariance = np.diag([noise_mm**2] * 3 + [min(noise_mm, 1e3) ** 2] * 3)
    result = assess(
        PoseCycles(positions, np.repeat(np.eye(3)[None], n, axis=0), np.repeat(covariance[None], n, axis=0))
    )
    values = np.array(numbers(result))
    assert np.isfinite(values).all()
    assert values.min() >= 0.0
