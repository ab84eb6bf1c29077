"""Simulated arms with gears and compliance: what is predicted, what is stated, and what a perfect robot keeps."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from core.kinematics import Blocking, Level, ModelChoice, joint_compliance, joint_curves
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import chain_frames, pose_with_jacobian
from core.kinematics.error_model.terms import Kind, term_columns, terms_of
from core.kinematics.identification import Identification, identify
from core.kinematics.identification.extension import MAX_ANGLE_UNCERTAINTY, MAX_LENGTH_UNCERTAINTY_MM
from core.simulation.arm import KR5_ARC
from tests.support.simulation.robots.arms import identifiable_truth, predictions, stated
from tests.support.simulation.robots.real_arms import (
    NOISE,
    RealArm,
    angles_within_limits,
    measured,
    real_arm,
)


def drawn(seed: int, count: int, *, perfect: bool = False) -> tuple[RealArm, np.ndarray, np.random.Generator]:
    rng = np.random.default_rng([seed, count])
    return real_arm(rng, perfect=perfect), angles_within_limits(rng, count), rng


def scores(real: RealArm, q: np.ndarray, found: Identification) -> np.ndarray:
    """Errors of the parameters in stated uncertainties."""
    ratio = (found.chain.as_array() - identifiable_truth(real.arm, q)) / stated(found)
    return ratio[np.isfinite(ratio)]


def test_a_curve_is_the_joint_s_own_turn() -> None:
    """The column of cos q is the derivative by the joint's offset, times cos q."""
    real, q, _ = drawn(1, 5)
    arm = ArmState(real.arm.chain.as_array(), real.arm.T_flange_camera, real.arm.T_target_base, np.zeros(0))
    target = np.array([0, 1, 0, 1, 1])
    columns, terms = term_columns(arm, q, target), terms_of(6)
    _, J = pose_with_jacobian(arm.parameters, q, arm.T_target_base[target], arm.T_flange_camera)
    for joint in range(6):
        curve = terms.curve(joint)
        assert columns[curve[0]] == pytest.approx(J[5 * joint + 3] * np.cos(q[:, joint]))
        assert columns[curve[60 + 2]] == pytest.approx(J[5 * joint + 3] * np.sin(3.0 * q[:, joint]))
    # The weight of one link, in its middle, turns the joint by its horizontal lever.
    at = arm.T_target_base[target][:, None] @ chain_frames(arm.parameters, q)
    origin, up = at[:, :, :3, 3], arm.T_target_base[target][:, :3, 2]
    for place, link in ((0, 2), (2, 4)):  # of joint 3
        lever = 0.5 * (origin[:, link] + origin[:, link + 1]) - origin[:, 2]
        moment = np.sum(at[:, 2, :3, 2] * np.cross(up, lever), axis=1) / 1000.0
        column = columns[np.flatnonzero(terms.of(Kind.LINK_COMPLIANCE) & (terms.joint == 2))[place]]
        assert column == pytest.approx(J[5 * 2 + 3] * moment)
    # Weight does not turn an axis that is upright.
    upright = columns[np.flatnonzero(terms.of(Kind.COMPLIANCE))[0]]
    assert upright == pytest.approx(np.zeros_like(upright), abs=1e-9)


def test_gears_and_compliance_are_found_and_predicted() -> None:
    real, q, rng = drawn(2, 120)
    found = identify(measured(real, q, rng), KR5_ARC, model=ModelChoice.AUTO)
    model = found.error_model
    assert model is not None
    assert model.level is Level.ALL
    assert model.held_out_ratio is not None
    assert model.blocked_ratio is not None
    assert model.held_out_ratio < 0.5
    assert model.blocked_ratio < 0.7
    assert found.validation is not None
    assert {block.blocking for block in found.validation.blocks} == set(Blocking)
    others = angles_within_limits(rng, 400)
    true = real.arm.camera_poses(real.turned(others))
    predicted, deviations = predictions(model, others)
    error = (true[:, :3, 3] - predicted[:, :3, 3]).T
    rms = math.sqrt(float(np.mean(np.sum(error**2, axis=0))))
    assert rms < 0.15
    # The truth has no noise of its own, which the deviations include.
    assert np.mean(np.abs(error) < 1.96 * deviations[:3]) > 0.9
    curves, compliance = joint_curves(model), joint_compliance(model)
    assert [curve.joint for curve in curves] == [1, 2, 3, 4, 5, 6]
    assert real.gears is not None
    left, whole = [], []
    for joint, curve in enumerate(curves):
        gears = real.gears.at(np.repeat(curve.angles[:, None], 6, axis=1))[:, joint]
        # Over a part of a turn, the chain's parameters take the mean and some of the first harmonic.
        chain = np.column_stack([np.ones_like(gears), np.cos(curve.angles), np.sin(curve.angles)])
        for of, values in ((left, curve.correction - gears), (whole, gears)):
            of.append(values - chain @ np.linalg.lstsq(chain, values, rcond=None)[0])
    assert np.std(np.concatenate(left)) < 0.6 * np.std(np.concatenate(whole))
    by_joint = {one.joint: one for one in compliance if one.axis == "z"}
    assert 1 not in by_joint
    assert by_joint[2].rad_per_m > 2.0 * by_joint[2].standard_uncertainty
    assert [region.joint for region in found.region] == [1, 2, 3, 4, 5, 6]


@pytest.mark.slow
def test_the_chain_s_uncertainties_hold_with_gears_and_compliance() -> None:
    ratio = []
    for seed in range(3):
        real, q, rng = drawn(seed, 60)
        ratio.append(
            scores(real, q, identify(measured(real, q, rng), KR5_ARC, folds=5, model=ModelChoice.AUTO))
        )
    # 66 scores; the chain alone has 2 to 3 here.
    assert float(np.sqrt(np.mean(np.concatenate(ratio) ** 2))) < 1.3


@pytest.mark.slow
def test_weights_unlike_those_of_even_links_are_no_lengths() -> None:
    """Joints three times as weak, under weights that no rule gives: with one lever a joint the scores are 1.9."""
    ratio = []
    for seed in range(4):
        even, q, rng = drawn(seed, 60)
        assert even.links is not None
        real = replace(even, links=replace(even.links, rad_per_nm=3.0 * even.links.rad_per_nm))
        found = identify(measured(real, q, rng), KR5_ARC, folds=5, model=ModelChoice.AUTO)
        ratio.append(scores(real, q, found))
    # 88 scores: four standard deviations of their root mean square are .3.
    assert float(np.sqrt(np.mean(np.concatenate(ratio) ** 2))) < 1.3


def test_a_perfect_robot_keeps_its_chain() -> None:
    for seed in range(2):
        real, q, rng = drawn(seed, 70, perfect=True)
        poses = measured(real, q, rng)
        found = identify(poses, KR5_ARC, model=ModelChoice.AUTO)
        assert found.error_model is not None
        assert found.error_model.level is Level.DH
        assert found.error_model.held_out_ratio == 1.0
        alone = identify(poses, KR5_ARC)
        known = np.isfinite(stated(alone))
        assert stated(found)[known] == pytest.approx(stated(alone)[known], rel=0.25)
        assert np.abs(found.chain.as_array() - alone.chain.as_array())[known] == pytest.approx(0.0, abs=0.02)


@pytest.mark.slow
def test_visits_to_one_configuration_count_once() -> None:
    """A gear's error is the same at each of ten visits, which say nothing more of it."""
    real, q, rng = drawn(5, 40)
    once = identify(measured(real, q, rng), KR5_ARC, model=ModelChoice.EXTENDED)
    again = measured(real, np.repeat(q, 10, axis=0), rng)
    labels = tuple(f"P{i // 10}" for i in range(400))
    often = identify(replace(again, labels=labels), KR5_ARC, model=ModelChoice.EXTENDED)
    assert often.error_model is not None
    assert once.error_model is not None
    assert len(often.error_model.fit.design) == len(once.error_model.fit.design) == 40
    assert often.used.shape == (400,)
    ratio = scores(real, q, often)
    assert float(np.sqrt(np.mean(ratio**2))) < 2.0


@pytest.mark.parametrize("perfect", [True, False])
def test_the_scatter_is_that_of_one_visit_however_often_configurations_were_visited(*, perfect: bool) -> None:
    real, q, rng = drawn(6, 40, perfect=perfect)
    found = identify(measured(real, np.tile(q, (8, 1)), rng), KR5_ARC, model=ModelChoice.AUTO)
    # 280 visits more than configurations, three coordinates each: 2.5 % of the whole, of which the robot's is a part.
    assert found.scatter_position_mm == pytest.approx(NOISE.position_mm, rel=0.15)
    assert found.scatter_rotation == pytest.approx(NOISE.rotation_rad, rel=0.15)
    model = found.error_model
    assert model is not None
    asked = angles_within_limits(rng, 200, 0.5)
    off = measured(real, asked, rng).positions_mm - predictions(model, asked)[0][:, :3, 3]
    within = np.abs(off.T) <= 1.96 * predictions(model, asked)[1][:3]
    assert np.mean(within) > 0.9


@pytest.mark.slow
def test_outliers_that_only_the_model_shows_are_rejected() -> None:
    real, q, rng = drawn(6, 120)
    poses = measured(real, q, rng)
    positions = poses.positions_mm.copy()
    positions[17] += [0.5, -0.4, 0.3]  # a fraction of what gears and bending do
    found = identify(replace(poses, positions_mm=positions), KR5_ARC, model=ModelChoice.AUTO)
    assert np.flatnonzero(~found.used).tolist() == [17]
    assert "poses_excluded" in {w.code for w in found.warnings}


def test_parameters_that_are_too_uncertain_are_not_identifiable() -> None:
    """Without a nominal there is no prior; joints that move by a degree or two determine little."""
    real, q, rng = drawn(7, 60)
    narrow = q.mean(axis=0) + 0.1 * (q - q.mean(axis=0))
    poses = measured(real, narrow, rng)
    noisy = poses.positions_mm + rng.normal(0.0, 1.0, (60, 3))
    poses = replace(poses, positions_mm=noisy, covariance=None)
    found = identify(poses, start=KR5_ARC, model=ModelChoice.EXTENDED)
    known = stated(found)
    assert np.nanmax(known[:, [0, 2]]) <= MAX_LENGTH_UNCERTAINTY_MM
    assert np.nanmax(known[:, [1, 3, 4]]) <= MAX_ANGLE_UNCERTAINTY
    assert any("is not determined to" in group.sentence for group in found.null_space)
    assert len(found.names) == len(found.covariance)


def test_positions_alone_have_a_model_too() -> None:
    real, q, rng = drawn(8, 100)
    poses = measured(real, q, rng)
    found = identify(replace(poses, rotations=None), KR5_ARC, model=ModelChoice.AUTO)
    assert found.error_model is not None
    assert found.error_model.growth.shape == (1,)
    assert found.error_model.held_out_ratio is not None
    assert found.error_model.held_out_ratio < 0.7
    assert predictions(found.error_model, q[:3])[1].shape == (3, 3)


@cache
def of_arm_on_wall(seed: int) -> np.ndarray:
    """Return the scores of an arm on a wall, which is named as such; the same arm standing is not."""
    real, q, rng = drawn(50 + seed, 80)
    assert real.links is not None
    on_wall = replace(real, links=replace(real.links, up=(0.0, 1.0, 0.0), rad_per_nm=2e-6))
    found = identify(measured(on_wall, q, rng), KR5_ARC, folds=0, model=ModelChoice.EXTENDED)
    assert "gravity_across_base" in {w.code for w in found.warnings}
    standing = identify(measured(real, q, rng), KR5_ARC, folds=0, model=ModelChoice.EXTENDED)
    assert "gravity_across_base" not in {w.code for w in standing.warnings}
    return scores(on_wall, q, found)


@pytest.mark.parametrize("arms", [2, pytest.param(5, marks=pytest.mark.slow)])
def test_a_robot_on_a_wall_is_recognised_by_the_weight_of_its_links(arms: int) -> None:
    """With gravity along the base's z axis, intervals held 85 %, and more poses made it worse."""
    found_scores = [of_arm_on_wall(seed) for seed in range(arms)]
    assert np.mean(np.abs(np.concatenate(found_scores)) < 1.96) > 0.95 - 3.5 * 0.06 / math.sqrt(arms)
