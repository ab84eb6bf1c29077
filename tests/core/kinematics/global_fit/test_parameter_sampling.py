"""Sampled uncertainties agree with the stated ones where the model is near linear, and differ where it is not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import InvalidArgument
from core.kinematics.dh import forward
from core.kinematics.global_fit import observations_of, placed
from core.kinematics.identification import ModelChoice, identify
from core.kinematics.identification.from_poses import solve
from core.kinematics.identification.sampling import sample_parameters
from core.simulation.arm import KR5_ARC, kr5_arc
from tests.support.simulation.robots.arm_grid_points import image_poses, session
from tests.support.simulation.robots.arms import angles
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

TRIALS = 100


def test_sampling_agrees_with_the_covariance_of_poses() -> None:
    rng = np.random.default_rng(3)
    poses = measure_poses(kr5_arc(rng), angles(rng), rng, robot=Repeatability(0.03, math.radians(0.005)))
    found = identify(poses, KR5_ARC, folds=0, trials=TRIALS)
    sampling = found.sampling
    assert sampling is not None
    assert len(sampling.ratio) == len(found.names)
    assert sampling.agrees.all()
    assert sampling.joint_ratio == pytest.approx(1.0, abs=0.05)
    assert identify(poses, KR5_ARC, folds=0).sampling is None


def test_sampling_agrees_with_the_covariance_of_images_of_one_lens() -> None:
    _, q, views, _ = session(11, count=40, position_mm=0.03, rotation_rad=math.radians(0.005))
    sampling = identify(image_poses(views, q), KR5_ARC, folds=0, trials=TRIALS).sampling
    assert sampling is not None
    assert sampling.agrees.all()
    assert sampling.joint_ratio == pytest.approx(1.0, abs=0.05)


def test_a_covariance_that_is_not_that_of_the_fit_is_found_out() -> None:
    rng = np.random.default_rng(4)
    poses = measure_poses(kr5_arc(rng), angles(rng), rng, robot=Repeatability(0.03, math.radians(0.005)))
    seen = observations_of(poses)
    start = placed(KR5_ARC.as_array(), forward(KR5_ARC, poses.joint_angles), seen)
    solution = solve(start, seen, poses)
    assert sample_parameters(solution.refined, seen, solution.gauge.free, TRIALS).agrees.all()
    doubled = replace(solution.refined, covariance=4.0 * solution.refined.covariance)
    sampling = sample_parameters(doubled, seen, solution.gauge.free, TRIALS)
    assert not sampling.agrees.any()
    assert sampling.joint_ratio == pytest.approx(0.5, abs=0.03)


def test_terms_beyond_the_chain_are_not_sampled() -> None:
    rng = np.random.default_rng(5)
    poses = measure_poses(kr5_arc(rng), angles(rng), rng)
    with pytest.raises(InvalidArgument, match="chain alone"):
        identify(poses, KR5_ARC, folds=0, model=ModelChoice.AUTO, trials=TRIALS)
