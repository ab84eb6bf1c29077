"""Nominal robots that state β, as those made from an identified arm do: the link keeps Hayati's form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.kinematics import reparametrise
from core.kinematics.circle_point_analysis import identify_from_axes
from core.kinematics.dh import Chain
from core.kinematics.equal_descriptions import turn
from core.kinematics.identification import identify
from core.kinematics.pose_observations import PoseData
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, Arm, free_angles, kr5_arc, sweep_angles
from tests.support.simulation.robots.arms import stated
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

A, ALPHA, D, THETA, BETA = range(5)
PARALLEL = [False, True, False, False, False]


def arm_and_nominal(seed: int, tilt_deg: float) -> tuple[Arm, Chain, Chain]:
    """An arm as built, its chain with β, and a nominal robot that an earlier identification of it left."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    parameters = arm.chain.as_array()
    parameters[1, [ALPHA, BETA]] += math.radians(tilt_deg)
    arm = replace(arm, chain=Chain.from_array(parameters))
    truth = reparametrise(arm.chain, PARALLEL, KR5_ARC)
    assert abs(truth.joints[1].beta_rad) > 1e-5
    off = np.zeros((6, 5))
    off[1:5, [A, D]] = rng.normal(0.0, 0.05, (4, 2))
    off[1:5, [ALPHA, THETA]] = rng.normal(0.0, 1e-4, (4, 2))
    off[1, [D, BETA]] = 0.0, 1e-4
    return arm, truth, Chain.from_array(truth.as_array() + off)


def poses_of(arm: Arm, seed: int) -> PoseData:
    rng = np.random.default_rng(seed)
    q = sweep_angles(KR5_ARC_HOME, half_arc=math.radians(40.0), steps=9)
    q = np.concatenate([q, free_angles(rng, KR5_ARC_HOME, 40)])
    robot = Repeatability(0.005, math.radians(0.0005))
    return measure_poses(arm, q, rng, estimator="given", robot=robot)


@pytest.mark.parametrize("tilt_deg", [0.0, 5.0], ids=["as workshops leave it", "whose d the poses determine"])
@pytest.mark.parametrize("seed", range(3))
def test_the_identification_has_the_nominal_s_form(seed: int, tilt_deg: float) -> None:
    arm, truth, nominal = arm_and_nominal(seed, tilt_deg)
    poses = poses_of(arm, seed)
    found = identify(poses, nominal, folds=0)
    assert [joint.parallel_to_next for joint in found.joints] == [*PARALLEL, False]
    second = found.joints[1]
    assert second.identifiable["beta_rad"]
    assert not second.identifiable["d_mm"]
    assert second.parameters.d_mm == nominal.joints[1].d_mm
    expected = reparametrise(arm.chain, PARALLEL, nominal).as_array()
    off = found.chain.as_array() - expected
    off[:, [ALPHA, THETA, BETA]] = turn(off[:, [ALPHA, THETA, BETA]])
    ratio = off / stated(found)
    assert np.nanmax(np.abs(ratio)) < 4.5
    np.testing.assert_allclose(expected, truth.as_array(), atol=0.5)
    by_axes = identify_from_axes(poses, nominal)
    assert by_axes.joints[1].parallel_to_next
    beta = by_axes.joints[1]
    sigma = beta.standard_uncertainty["beta_rad"]
    assert sigma is not None
    assert abs(beta.parameters.beta_rad - expected[1, BETA]) < 4.5 * sigma
