"""Joints that stop short of where they go: found where the order is known, no harm where it is wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.kinematics import Level, ModelChoice, joint_approach
from core.kinematics.identification import Identification, identify
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import KR5_ARC
from tests.support.simulation.robots.arms import predictions
from tests.support.simulation.robots.real_arms import RealArm, angles_within_limits, measured, real_arm

OFFSETS = np.radians([0.015, -0.01, 0.012, 0.0, 0.02, 0.01])
"""Of joints that come from smaller angles."""


def signs_of(q: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros((1, 6)), np.sign(np.diff(q, axis=0))])


def with_play(real: RealArm, q: np.ndarray, rng: np.random.Generator) -> PoseData:
    """Poses of an arm whose joints stop at their offsets by the side they come from, the order known."""
    signs = signs_of(q)
    poses = measured(real, q + signs * OFFSETS, rng)
    return replace(poses, joint_angles=q, approach=signs)


def found_of(poses: PoseData) -> Identification:
    return identify(poses, KR5_ARC, model=ModelChoice.AUTO)


def test_what_the_side_of_approach_does_is_found_and_predicts_better() -> None:
    rng = np.random.default_rng(11)
    real, q = real_arm(rng, perfect=True), angles_within_limits(rng, 100)
    poses = with_play(real, q, rng)
    found, blind = found_of(poses), found_of(replace(poses, approach=None))
    assert "approach_matters" in {warning.code for warning in found.warnings}
    model = found.error_model
    assert model is not None
    assert model.level is Level.ALL
    offsets = joint_approach(model)
    assert [one.joint for one in offsets] == [1, 2, 3, 4, 5, 6]
    scores = np.array(
        [(one.offset - true) / one.standard_uncertainty for one, true in zip(offsets, OFFSETS, strict=True)]
    )
    assert np.all(np.abs(scores) < 4.0)
    assert max(one.standard_uncertainty for one in offsets) < math.radians(0.003)
    assert model.held_out_ratio is not None
    assert model.held_out_ratio < 0.7
    assert blind.error_model is not None
    assert not joint_approach(blind.error_model)
    # Where the side is not known, a prediction lies between the two, and says how far they are.
    others = angles_within_limits(rng, 200)
    predicted, deviations = predictions(model, others)
    for side in (-1.0, 1.0):
        true = real.arm.camera_poses(real.turned(others + side * OFFSETS))
        error = (true[:, :3, 3] - predicted[:, :3, 3]).T
        assert np.mean(np.abs(error) < 1.96 * deviations[:3]) > 0.9


@pytest.mark.slow
def test_a_wrong_order_does_no_harm() -> None:
    rng = np.random.default_rng(12)
    real, q = real_arm(rng), angles_within_limits(rng, 100)
    poses = measured(real, q, rng)
    wrong = replace(poses, approach=rng.choice([-1.0, 1.0], (100, 6)))
    identified = found_of(wrong)
    assert "approach_matters" not in {warning.code for warning in identified.warnings}
    with_terms, without = identified.error_model, found_of(poses).error_model
    assert with_terms is not None
    assert without is not None
    assert with_terms.level is without.level
    for one in joint_approach(with_terms):
        assert abs(one.offset) < 4.0 * one.standard_uncertainty
    assert with_terms.held_out_ratio == pytest.approx(without.held_out_ratio, rel=0.08)
