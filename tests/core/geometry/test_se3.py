"""Rigid motions: round trips, group laws, Jacobians against differences, means."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.errors import InvalidArgument
from core.geometry.roll_pitch_yaw import rotation_to_rpy, rpy_jacobian, rpy_to_rotation
from core.geometry.se3 import (
    are_rotations,
    compose,
    hat,
    hats,
    invert,
    nearest_rotation,
    rotation_mean,
    rotation_vectors,
    rotations_about,
    rotations_from_vectors,
    so3_exp,
    so3_log,
    transform,
    transform_mean,
    transform_points,
)

angles = st.floats(-math.pi, math.pi)
components = st.floats(-1.0, 1.0)
vectors = st.tuples(components, components, components).map(np.array)


def test_a_quarter_turn_about_z_takes_x_to_y() -> None:
    R = so3_exp(np.array([0.0, 0.0, math.pi / 2]))
    np.testing.assert_allclose(R @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


@given(vectors, st.floats(0.0, math.pi - 1e-6))
def test_log_undoes_exp(direction: np.ndarray, angle: float) -> None:
    norm = np.linalg.norm(direction)
    w = direction / norm * angle if norm > 1e-3 else np.array([angle, 0.0, 0.0])
    np.testing.assert_allclose(so3_log(so3_exp(w)), w, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-3, 1.0, math.pi - 1e-7, math.pi])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (-1, 2, -3)])
def test_log_is_exact_from_no_turn_to_half_a_turn(angle: float, axis: tuple[int, int, int]) -> None:
    w = np.array(axis, float) / np.linalg.norm(axis) * angle
    recovered = so3_log(so3_exp(w))
    # At π both signs are the same rotation.
    error = min(np.linalg.norm(recovered - w), np.linalg.norm(recovered + w) if angle == math.pi else np.inf)
    assert error < 1e-9


@pytest.mark.parametrize("each", [False, True], ids=["about one", "each about its own"])
def test_rotation_vectors_turn_what_they_are_about(*, each: bool) -> None:
    rng = np.random.default_rng(4)
    turns = rng.normal(size=(40, 3))
    turns *= (np.linspace(0.0, math.pi - 1e-6, 40) / np.linalg.norm(turns, axis=1))[:, None]
    about = rotations_from_vectors(rng.normal(size=(40, 3))) if each else so3_exp(rng.normal(size=3))
    found = rotation_vectors(rotations_from_vectors(turns) @ about, about)
    np.testing.assert_allclose(found, turns, atol=1e-9)


@given(angles, st.floats(-1.55, 1.55), angles)
def test_roll_pitch_yaw_round_trip(roll: float, pitch: float, yaw: float) -> None:
    R = rpy_to_rotation(np.array([roll, pitch, yaw]))
    np.testing.assert_allclose(rpy_to_rotation(rotation_to_rpy(R)), R, atol=1e-12)
    expected = (
        so3_exp(np.array([0, 0, yaw])) @ so3_exp(np.array([0, pitch, 0])) @ so3_exp(np.array([roll, 0, 0]))
    )
    np.testing.assert_allclose(R, expected, atol=1e-12)


def test_at_the_singularity_roll_is_zero_and_the_rotation_is_kept() -> None:
    R = rpy_to_rotation(np.array([0.3, math.pi / 2, 0.5]))
    rpy = rotation_to_rpy(R)
    assert rpy[0] == 0.0
    np.testing.assert_allclose(rpy_to_rotation(rpy), R, atol=1e-9)


@pytest.mark.parametrize("distance", [1e-4, 1e-8, 1e-10, 3e-12])
def test_near_the_singularity_the_rotation_is_kept_to_the_last_digits(distance: float) -> None:
    R = rpy_to_rotation(np.array([0.3, math.pi / 2 - distance, 0.5]))
    np.testing.assert_allclose(rpy_to_rotation(rotation_to_rpy(R)), R, atol=1e-14)


@given(vectors.filter(lambda v: abs(v[1]) < 0.9))
def test_angle_jacobian_matches_differences(v: np.ndarray) -> None:
    rpy = v * [3.0, 1.5, 3.0]
    R = rpy_to_rotation(rpy)
    h = 1e-6
    for axis in range(3):
        w = np.zeros(3)
        w[axis] = h
        plus, minus = rotation_to_rpy(so3_exp(w) @ R), rotation_to_rpy(so3_exp(-w) @ R)
        difference = (plus - minus + math.pi) % (2 * math.pi) - math.pi
        np.testing.assert_allclose(rpy_jacobian(rpy)[:, axis], difference / (2 * h), atol=1e-6)


@given(vectors, vectors, vectors)
def test_names_cancel(w: np.ndarray, t: np.ndarray, point: np.ndarray) -> None:
    T_a_b, T_b_c = transform(so3_exp(w), t), transform(so3_exp(2 * t), w)
    there = transform_points(compose(T_a_b, T_b_c), point[None])
    np.testing.assert_allclose(
        there, transform_points(T_a_b, transform_points(T_b_c, point[None])), atol=1e-12
    )
    np.testing.assert_allclose(compose(T_a_b, invert(T_a_b)), np.eye(4), atol=1e-12)


def test_nearest_rotation_is_right_handed_even_for_a_reflection() -> None:
    R = nearest_rotation(np.diag([1.0, 1.0, -1.0]))
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_many_matrices_are_treated_as_each_alone() -> None:
    rng = np.random.default_rng(3)
    matrices, vectors = rng.normal(size=(2, 5, 3, 3)), rng.normal(size=(2, 5, 3))
    nearest, crossed = nearest_rotation(matrices), hats(vectors)
    for i, j in np.ndindex(2, 5):
        np.testing.assert_allclose(nearest[i, j], nearest_rotation(matrices[i, j]), atol=1e-14)
        np.testing.assert_array_equal(crossed[i, j], hat(vectors[i, j]))
    direction, turns = vectors[0] / np.linalg.norm(vectors[0], axis=1, keepdims=True), rng.normal(size=(5, 4))
    turned = rotations_about(direction, turns)
    for i, j in np.ndindex(5, 4):
        np.testing.assert_allclose(turned[i, j], so3_exp(turns[i, j] * direction[i]), atol=1e-14)


def test_scaled_sheared_and_mirrored_matrices_are_no_rotations() -> None:
    R = so3_exp(np.array([0.3, -0.2, 0.9]))
    sheared = R + 1e-5 * np.outer([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    found = are_rotations(np.array([R, np.round(R, 7), (1.0 + 1e-5) * R, sheared, -R]))
    assert found.tolist() == [True, True, False, False, False]


def test_the_mean_of_scattered_rotations_recovers_the_centre() -> None:
    rng = np.random.default_rng(5)
    centre, sigma, count = so3_exp(np.array([0.4, -1.0, 2.0])), 0.02, 2000
    scattered = np.array([so3_exp(w) @ centre for w in rng.normal(0.0, sigma, (count, 3))])
    error = so3_log(rotation_mean(scattered) @ centre.T)
    # Each component of the mean has σ/√n; five of those is a bound that chance does not cross.
    assert np.all(np.abs(error) < 5 * sigma / math.sqrt(count))


def test_the_mean_of_rotations_is_where_their_logs_cancel() -> None:
    rotations = np.array([so3_exp(np.array(w)) for w in ([0.1, 0, 0], [0, 0.9, 0], [0, 0, -1.2])])
    mean = rotation_mean(rotations)
    np.testing.assert_allclose(np.sum([so3_log(R @ mean.T) for R in rotations], axis=0), 0.0, atol=1e-12)


def test_the_mean_pose_has_the_mean_position() -> None:
    T = np.array([transform(np.eye(3), np.array([x, 0.0, 0.0])) for x in (0.0, 4.0)])
    np.testing.assert_allclose(transform_mean(T)[:3, 3], [2.0, 0.0, 0.0])


def test_no_rotations_have_no_mean() -> None:
    with pytest.raises(InvalidArgument):
        rotation_mean(np.zeros((0, 3, 3)))
