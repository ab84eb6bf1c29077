"""What no change of frame, order or unit may change."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.geometry.roll_pitch_yaw import rpy_to_rotation
from core.geometry.se3 import so3_exp
from core.metrology import PoseCycles, PoseRepeatability, assess_repeatability

numbers_of_cycles = st.integers(2, 40)
seeds = st.integers(0, 10_000)
angles = st.floats(-3.0, 3.0)
POSITION = ("position_mm",)
LENGTHS = ("position_mm", "x_mm", "y_mm", "z_mm")
ANGLES = ("roll", "pitch", "yaw")


def draw_cycles(n: int, seed: int) -> PoseCycles:
    """Robot and instrument of any shape; the instrument differs from cycle to cycle."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) * np.array([0.03] * 3 + [2e-4] * 3)[:, None]
    draws = rng.normal(size=(n, 6)) @ root.T
    roots = rng.normal(size=(n, 6, 6)) * np.array([0.005] * 3 + [3e-5] * 3)[:, None]
    mean = rpy_to_rotation(np.array([0.4, 0.7, -1.0]))
    return PoseCycles(
        rng.normal(size=3) * 500.0 + draws[:, :3],
        np.array([so3_exp(w) @ mean for w in draws[:, 3:]]),
        roots @ roots.transpose(0, 2, 1),
    )


def assess(cycles: PoseCycles) -> PoseRepeatability:
    return assess_repeatability([cycles])[0]


def assert_equivalent(
    a: PoseRepeatability, b: PoseRepeatability, names: tuple[str, ...], scale: float = 1.0
) -> None:
    for field in ("repeatability", "interval", "noise_floor", "corrected", "corrected_interval"):
        for name in names:
            left, right = getattr(getattr(a, field), name), getattr(getattr(b, field), name)
            assert (left is None) == (right is None)
            if left is not None:
                size = getattr(a.repeatability, name) * scale
                # √ of a difference that vanishes keeps half the digits
                assert np.asarray(right) == pytest.approx(np.asarray(left) * scale, rel=1e-6, abs=1e-6 * size)
    assert a.verdict == b.verdict


@settings(max_examples=40)
@given(numbers_of_cycles, seeds, angles, angles, angles)
def test_rigid_motion_of_the_frame(n: int, seed: int, roll: float, pitch: float, yaw: float) -> None:
    cycles = draw_cycles(n, seed)
    assert cycles.rotations is not None
    Q = rpy_to_rotation(np.array([roll, pitch, yaw]))
    QQ = np.kron(np.eye(2), Q)
    moved = PoseCycles(
        cycles.positions_mm @ Q.T + [300.0, -20.0, 5.0], Q @ cycles.rotations, QQ @ cycles.covariances @ QQ.T
    )
    before, after = assess(cycles), assess(moved)
    assert_equivalent(before, after, POSITION)
    assert before.orientation is not None
    assert after.orientation is not None
    lengths = [np.linalg.norm(r.orientation.vector_xyz) for r in (before, after) if r.orientation]
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-9)
    means = [rpy_to_rotation(r.mean_roll_pitch_yaw) for r in (before, after)]
    np.testing.assert_allclose(Q @ means[0], means[1], atol=1e-12)


@settings(max_examples=40)
@given(numbers_of_cycles, seeds, st.randoms(use_true_random=False))
def test_order_of_cycles(n: int, seed: int, random: object) -> None:
    cycles = draw_cycles(n, seed)
    order = list(range(n))
    random.shuffle(order)  # type: ignore[attr-defined]
    assert_equivalent(assess(cycles), assess(cycles.take(np.array(order))), LENGTHS + ANGLES)


@settings(max_examples=40)
@given(numbers_of_cycles, seeds, st.floats(1e-3, 1e3))
def test_unit_of_length(n: int, seed: int, scale: float) -> None:
    cycles = draw_cycles(n, seed)
    weight = np.diag([scale] * 3 + [1.0] * 3)
    scaled = PoseCycles(cycles.positions_mm * scale, cycles.rotations, weight @ cycles.covariances @ weight)
    assert_equivalent(assess(cycles), assess(scaled), LENGTHS, scale)
    assert_equivalent(assess(cycles), assess(scaled), ANGLES)


@given(numbers_of_cycles, seeds)
def test_size_of_the_scatter_and_order_of_what_is_said(n: int, seed: int) -> None:
    result = assess(draw_cycles(n, seed))
    for name in LENGTHS + ANGLES:
        reading, corrected = getattr(result.repeatability, name), getattr(result.corrected, name)
        low, high = getattr(result.interval, name)
        assert 0.0 <= low <= reading <= high
        assert 0.0 <= corrected <= reading
