"""One joint's motion: derivatives, closed forms, robust starts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from core.errors import DegenerateGeometry
from core.geometry.se3 import rotations_about, so3_exp, so3_log
from core.kinematics.joint_axes.arc_fit import robust_start
from core.kinematics.joint_axes.arc_model import (
    ArcObservations,
    Motion,
    angle_derivative,
    jacobian,
    linearised,
    residuals,
    with_angles,
)
from core.kinematics.joint_axes.closed_form import (
    Motions,
    motions_by_circle,
    motions_by_encoder,
    motions_by_rotations,
)
from core.numerics.variance_components import Variances, weights

POINT, DIRECTION = np.array([300.0, -150.0, 700.0]), so3_exp(np.array([0.5, -1.1, 0.4])) @ [0.0, 0.0, 1.0]
OUT = 600.0 * np.cross(DIRECTION, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(DIRECTION, [1.0, 0.0, 0.0]))
START = so3_exp(np.array([2.0, 0.3, -0.4]))


def arc_of(angles: np.ndarray, radius: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    D = rotations_about(DIRECTION, angles)
    return POINT + radius * (D @ OUT), D @ START


def state(rng: np.random.Generator, angles: np.ndarray, with_rotations: bool) -> Motion:
    return Motion(
        POINT + rng.normal(0.0, 1.0, 3),
        so3_exp(rng.normal(0.0, 0.02, 3)) @ DIRECTION,
        POINT + OUT + rng.normal(0.0, 2.0, 3),
        so3_exp(rng.normal(0.0, 0.02, 3)) @ START if with_rotations else None,
        angles + rng.normal(0.0, 0.02, len(angles)),
    )


@pytest.mark.parametrize("with_rotations", [True, False])
@pytest.mark.parametrize("free_angles", [True, False])
def test_derivatives_match_differences(with_rotations: bool, free_angles: bool) -> None:
    rng = np.random.default_rng(5)
    angles = np.linspace(-0.7, 0.7, 5)
    positions, rotations = arc_of(angles)
    m = 6 if with_rotations else 3
    seen = ArcObservations(
        positions, rotations if with_rotations else None, angles, np.tile(np.eye(m), (5, 1, 1)), free_angles
    )
    motion = state(rng, angles, with_rotations)
    held = ArcObservations(seen.positions, seen.rotations, angles, seen.whitening, False)
    J = jacobian(motion, seen)
    assert (
        J.shape[2]
        == {(True, True): 9, (True, False): 10, (False, True): 6, (False, False): 7}[
            with_rotations, free_angles
        ]
    )

    def moved(step: np.ndarray) -> np.ndarray:
        # The parameters' own motion, the free angles held: what they do follows from `angle_derivative`.
        if not free_angles:
            return residuals(motion.moved(step, seen), seen)
        full = np.insert(step, 5, 0.0) if not with_rotations else np.append(step, 0.0)
        return residuals(motion.moved(full, held), seen)

    h = 1e-5
    for k in range(J.shape[2]):
        step = np.zeros(J.shape[2])
        step[k] = h
        difference = (moved(-step) - moved(step)) / (2.0 * h)
        # Residuals of some hundredths of a radian turn the logarithm's derivative by half as much.
        np.testing.assert_allclose(J[:, :, k], difference, rtol=0.05, atol=0.05)
        np.testing.assert_allclose(J[:, :3, k], difference[:, :3], rtol=1e-5, atol=1e-4)
    turned = [
        residuals(
            Motion(motion.point, motion.direction, motion.position, motion.rotation, motion.angles + s), held
        )
        for s in (-h, h)
    ]
    np.testing.assert_allclose(
        angle_derivative(motion, seen)[:, :3],
        ((turned[0] - turned[1]) / (2.0 * h))[:, :3],
        rtol=1e-6,
        atol=1e-4,
    )


def test_free_angles_leave_what_is_across_the_motion() -> None:
    rng = np.random.default_rng(6)
    angles = np.linspace(-0.7, 0.7, 6)
    positions, rotations = arc_of(angles)
    W = weights(np.tile(np.diag([4.0, 1.0, 1.0, 1e-6, 1e-6, 2e-6]), (6, 1, 1)), Variances(1e-12, 1e-18))
    seen = ArcObservations(positions, rotations, angles, W, True)
    motion = state(rng, angles, True)
    r, J, whitening = linearised(motion, seen)
    assert (r.shape, J.shape) == ((6, 5), (6, 5, 9))
    across = np.einsum("nrm,nm->nr", whitening, angle_derivative(motion, seen))
    np.testing.assert_allclose(across, 0.0, atol=1e-9)
    # Nothing else is lost: 1 = WᵀW + its share along the angle.
    full = np.einsum("nij,nj->ni", W, residuals(motion, seen))
    g = np.einsum("nij,nj->ni", W, angle_derivative(motion, seen))
    along = np.sum(full * g, axis=1) ** 2 / np.sum(g * g, axis=1)
    np.testing.assert_allclose(np.sum(r**2, axis=1) + along, np.sum(full**2, axis=1), rtol=1e-9)


def by_rotations(positions: Any, rotations: Any, encoder: Any, *, free_angles: bool) -> Motion:
    return motions_by_rotations(
        positions[None], rotations[None], encoder[None], free_angles=free_angles
    ).all.one(0)


def by_encoder(positions: Any, encoder: Any) -> Motion:
    return motions_by_encoder(positions[None], encoder[None]).all.one(0)


def by_circle(positions: Any, encoder: Any) -> Motion:
    return motions_by_circle(positions[None], encoder[None]).all.one(0)


@pytest.mark.parametrize("arc", [10.0, 80.0, 200.0, 340.0, 700.0])
def test_closed_forms_are_exact(arc: float) -> None:
    encoder = np.radians(np.linspace(-arc / 2.0, arc / 2.0, 23))
    positions, rotations = arc_of(encoder)
    found = [
        by_rotations(positions, rotations, encoder, free_angles=False),
        by_rotations(positions, rotations, encoder, free_angles=True),
        by_encoder(positions, encoder),
        by_circle(positions, encoder),
    ]
    for motion in found:
        np.testing.assert_allclose(motion.direction, DIRECTION, atol=1e-7)
        np.testing.assert_allclose(np.cross(motion.point - POINT, DIRECTION), 0.0, atol=1e-4)
        assert motion.radius == pytest.approx(600.0, abs=1e-4)
        D = rotations_about(motion.direction, motion.angles)
        again = motion.point + D @ (motion.position - motion.point)
        np.testing.assert_allclose(again, positions, atol=1e-4)


def test_the_sense_is_the_encoders() -> None:
    encoder = np.linspace(-0.5, 0.5, 7)
    positions, rotations = arc_of(-encoder)
    for motion in (
        by_rotations(positions, rotations, encoder, free_angles=True),
        by_encoder(positions, encoder),
        by_circle(positions, encoder),
    ):
        np.testing.assert_allclose(motion.direction, -DIRECTION, atol=1e-6)


def test_positions_that_do_not_go_round_have_no_motion() -> None:
    encoder = np.linspace(-0.5, 0.5, 7)
    positions, _ = arc_of(encoder)
    straight = np.outer(encoder, [10.0, 20.0, 30.0])
    for motions in (motions_by_encoder, motions_by_circle):
        assert motions(np.array([straight, positions]), np.tile(encoder, (2, 1))).none.tolist() == [
            True,
            False,
        ]
    assert motions_by_circle(np.tile(POINT, (1, 7, 1)), encoder[None]).none.tolist() == [True]
    for rotations in (None, np.tile(np.eye(3), (7, 1, 1))):
        if rotations is None:
            with pytest.raises(DegenerateGeometry):
                robust_start(straight, rotations, encoder, free_angles=True)


def test_many_at_once_are_as_one_by_one() -> None:
    rng = np.random.default_rng(4)
    encoder = np.linspace(-0.6, 0.7, 9)
    positions, rotations = arc_of(encoder)
    some = np.array([np.sort(rng.permutation(9)[:4]) for _ in range(5)])
    noisy = positions + rng.normal(0.0, 0.5, positions.shape)
    seen = ArcObservations(noisy, rotations, encoder, np.tile(np.eye(6), (9, 1, 1)), True)

    def check(many: Motions, alone: list[Motion]) -> None:
        for k, one in enumerate(alone):
            for name in ("point", "direction", "position", "angles"):
                np.testing.assert_allclose(getattr(many.all.one(k), name), getattr(one, name), atol=1e-9)

    check(
        motions_by_rotations(noisy[some], rotations[some], encoder[some], free_angles=True),
        [by_rotations(noisy[i], rotations[i], encoder[i], free_angles=True) for i in some],
    )
    check(motions_by_encoder(noisy[some], encoder[some]), [by_encoder(noisy[i], encoder[i]) for i in some])
    check(motions_by_circle(noisy[some], encoder[some]), [by_circle(noisy[i], encoder[i]) for i in some])
    many = motions_by_rotations(noisy[some], rotations[some], encoder[some], free_angles=True).all
    many = replace(many, angles=np.tile(encoder, (5, 1)))
    turned = with_angles(many, seen)
    for k in range(5):
        alone = with_angles(many.one(k), seen)
        np.testing.assert_allclose(turned.angles[k], alone.angles, atol=1e-12)
        np.testing.assert_allclose(residuals(turned, seen)[k], residuals(alone, seen), atol=1e-9)


@pytest.mark.parametrize("with_rotations", [True, False])
@pytest.mark.parametrize("free_angles", [True, False])
def test_wrong_poses_do_not_spoil_the_start(with_rotations: bool, free_angles: bool) -> None:
    rng = np.random.default_rng(7)
    encoder = np.linspace(-0.7, 0.7, 12)
    positions, rotations = arc_of(encoder)
    positions = positions + rng.normal(0.0, 0.05, positions.shape)
    positions[[1, 5, 8]] += rng.normal(0.0, 200.0, (3, 3))
    rotations[1] = so3_exp(np.array([0.0, 1.0, 0.0])) @ rotations[1]
    motion = robust_start(positions, rotations if with_rotations else None, encoder, free_angles=free_angles)
    assert math.degrees(float(np.linalg.norm(np.cross(motion.direction, DIRECTION)))) < 1.0
    assert np.linalg.norm(np.cross(motion.point - POINT, DIRECTION)) < 10.0


def test_motions_keep_their_pose_on_the_way() -> None:
    encoder = np.linspace(-0.5, 0.5, 7)
    positions, rotations = arc_of(encoder)
    seen = ArcObservations(positions, rotations, encoder, np.tile(np.eye(6), (7, 1, 1)), False)
    motion = by_rotations(positions, rotations, encoder, free_angles=False)
    there = motion.moved(np.array([1.0, -2.0, 0.01, 0.02, 1.0, 1.0, 1.0, 0.01, 0.0, -0.01]), seen)
    out = there.position - there.point
    assert abs(out @ there.direction) < 1e-9
    assert there.rotation is not None
    assert motion.rotation is not None
    assert np.linalg.norm(so3_log(there.rotation @ motion.rotation.T)) == pytest.approx(
        math.hypot(0.01, 0.01), rel=1e-6
    )
