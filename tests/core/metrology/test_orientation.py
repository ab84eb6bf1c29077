"""Rotation vectors about the mean, and the angles they stand for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry.roll_pitch_yaw import rpy_to_rotation
from core.geometry.se3 import rotation_mean, rotation_vectors, so3_exp, so3_log
from core.metrology.pose_cycles import (
    angles_about_mean,
    angles_from_vectors,
    mean_and_vectors,
)


@pytest.mark.parametrize("angle", [0.0, 1e-10, 1e-5, 0.1, 1.5, 3.0, 3.1, math.pi - 1e-7])
def test_vectors_are_the_logarithms_one_by_one(angle: float) -> None:
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(20, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    about = so3_exp(np.array([0.3, -0.2, 0.5]))
    rotations = np.array([so3_exp(angle * axis) @ about for axis in axes])
    expected = np.array([so3_log(R @ about.T) for R in rotations])
    np.testing.assert_allclose(rotation_vectors(rotations, about), expected, atol=1e-9)


def test_the_mean_is_the_riemannian_mean() -> None:
    rng = np.random.default_rng(2)
    about = so3_exp(np.array([1.0, 0.4, -2.0]))
    rotations = np.array([so3_exp(w) @ about for w in rng.normal(scale=0.3, size=(30, 3))])
    mean, vectors = mean_and_vectors(rotations)
    np.testing.assert_allclose(mean, rotation_mean(rotations), atol=1e-13)
    np.testing.assert_allclose(vectors.mean(axis=0), 0.0, atol=1e-13)


def test_mapped_vectors_are_the_angles_to_second_order() -> None:
    rng = np.random.default_rng(3)
    centre = np.array([0.4, 1.1, -2.0])
    changes = rng.normal(scale=1e-4, size=(50, 3))
    rotations = np.array([rpy_to_rotation(centre + c) for c in changes])
    mean, vectors = mean_and_vectors(rotations)
    mapped = vectors @ angles_from_vectors(mean).T
    np.testing.assert_allclose(mapped, changes - changes.mean(axis=0), atol=1e-7)
    np.testing.assert_allclose(angles_about_mean(rotations, mean), mapped, atol=1e-7)


def test_angles_do_not_jump_at_half_a_turn() -> None:
    yaw = math.pi + np.array([-2e-3, -1e-3, 0.0, 1e-3, 2e-3])
    rotations = np.array([rpy_to_rotation(np.array([0.0, 0.0, a])) for a in yaw])
    mean, _ = mean_and_vectors(rotations)
    np.testing.assert_allclose(angles_about_mean(rotations, mean)[:, 2], yaw - math.pi, atol=1e-12)
