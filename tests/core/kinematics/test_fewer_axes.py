"""Correction of arms with fewer than six axes: what they cannot correct is stated, and is no singularity."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest

from core.geometry.se3 import so3_exp, transform
from core.kinematics import Chain, CorrectionModel, ModelChoice, Outcome, correct, correction_model, identify
from core.simulation.arm import KR5_ARC, Arm, deviated
from tests.support.simulation.robots.arms import angles
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

PALLETISER = Chain.from_rows(
    [(300.0, -90.0, 600.0, 0.0), (1050.0, 0.0, 0.0, 0.0), (1100.0, 0.0, 0.0, 0.0), (250.0, -90.0, 0.0, 0.0)]
)
PALLETISER_RANGE = np.radians([(-150.0, 150.0), (-100.0, 0.0), (10.0, 110.0), (-90.0, 90.0)])
SCARA = Chain.from_rows([(350.0, 0.0, 400.0, 0.0), (300.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
SCARA_RANGE = np.radians([(-130.0, 130.0), (-140.0, 140.0), (-170.0, 170.0)])
ROBOT = Repeatability(0.02, math.radians(0.003))


def drawn(rng: np.random.Generator, limits: np.ndarray, count: int, share: float = 1.0) -> np.ndarray:
    middle, half = limits.mean(axis=1), 0.5 * np.ptp(limits, axis=1)
    return np.asarray(middle + share * half * rng.uniform(-1.0, 1.0, (count, len(limits))))


def corrected_by(nominal: Chain, limits: np.ndarray, seed: int) -> CorrectionModel:
    rng = np.random.default_rng(seed)
    base = transform(so3_exp(np.array([0.02, -0.03, 0.7])), np.array([2500.0, -1800.0, 300.0]))
    tool = transform(so3_exp(np.array([0.3, 0.0, 0.5])), np.array([60.0, -35.0, 90.0]))
    arm = Arm(deviated(nominal, rng, 1.0, math.radians(0.05)), base[None], tool)
    poses = measure_poses(arm, drawn(rng, limits, 60), rng, estimator="given", robot=ROBOT)
    found = identify(poses, nominal, model=ModelChoice.AUTO)
    assert found.error_model is not None
    assert found.nominal_arm is not None
    return correction_model(found.error_model, found.nominal_arm, found.validation, curves=False)


def test_a_palletiser_corrects_positions_whole_and_says_what_is_left() -> None:
    by = corrected_by(PALLETISER, PALLETISER_RANGE, 1)
    q = drawn(np.random.default_rng(2), PALLETISER_RANGE, 120, 0.85)
    found = correct(by, q)
    assert Counter(found.outcomes) == {Outcome.CORRECTED: 120}
    components = found.components
    assert (components.axes, components.position, components.rotation) == (4, 3, 1)
    assert not components.complete
    assert components.base_axis is None
    off = by.attained(found.joint_angles) - by.meant(q)
    assert found.left[0] == pytest.approx(np.linalg.norm(off[:, :3, 3], axis=1))
    assert np.max(found.left[0]) < 0.05 < np.median(found.shift[0])
    assert np.median(found.left[1]) > math.radians(0.005)
    assert np.all(found.expected[1] >= found.left[1])


def test_a_scara_is_near_a_singularity_at_its_stretched_elbow_alone() -> None:
    by = corrected_by(SCARA, SCARA_RANGE, 3)
    q = drawn(np.random.default_rng(4), SCARA_RANGE, 120, 0.85)
    q[:, 1] = np.copysign(np.radians(30.0) + np.abs(q[:, 1]) * 0.7, q[:, 1])
    stretched = q[:5].copy()
    stretched[:, 1] = 0.0
    found = correct(by, np.concatenate([q, stretched]))
    assert set(found.outcomes[:120]) == {Outcome.CORRECTED}
    assert set(found.outcomes[120:]) == {Outcome.NEAR_SINGULARITY}
    components = found.components
    assert (components.axes, components.position, components.rotation) == (3, 2, 1)
    assert components.base_axis == 2
    # What is left of the position lies along the axes.
    off = (by.attained(found.joint_angles) - by.meant(np.concatenate([q, stretched])))[:120, :3, 3]
    along = off @ by.nominal.T_target_base[0][:3, 2]
    assert np.linalg.norm(off, axis=1) == pytest.approx(np.abs(along), abs=0.02)


def test_an_arm_of_six_axes_corrects_all_components() -> None:
    rng = np.random.default_rng(5)
    arm = Arm(deviated(KR5_ARC, rng, 0.5, 1e-3), np.eye(4)[None], np.eye(4))
    poses = measure_poses(arm, angles(rng, free=40), rng, estimator="given", robot=ROBOT)
    found = identify(poses, KR5_ARC, model=ModelChoice.AUTO)
    assert found.error_model is not None
    assert found.nominal_arm is not None
    by = correction_model(found.error_model, found.nominal_arm, found.validation, curves=False)
    assert correct(by, poses.joint_angles[:1]).components.complete
