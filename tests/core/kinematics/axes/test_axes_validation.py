"""Held-out validation of what sweeps determine: the noise and no more, gross errors counted, too few poses said."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.geometry.se3 import so3_exp
from core.kinematics.circle_point_analysis.identification import identify_from_axes
from core.simulation.arm import KR5_ARC, KR5_ARC_HOME, free_angles, kr5_arc, sweep_angles
from tests.support.simulation.simulated_poses import Repeatability, measure_poses

ROBOT = Repeatability(0.05, math.radians(0.005))
SWEEPS = sweep_angles(KR5_ARC_HOME, steps=9)


@pytest.mark.parametrize("method", ["cpa", "screw", "combined"])
def test_what_is_held_out_is_predicted_but_for_the_noise(method: str) -> None:
    rng = np.random.default_rng(21)
    arm = kr5_arc(rng)
    q = np.concatenate([SWEEPS, free_angles(rng, KR5_ARC_HOME, 12)])
    found = identify_from_axes(measure_poses(arm, q, rng, robot=ROBOT), KR5_ARC, method, folds=5)
    validation = found.validation
    assert validation is not None
    assert (validation.held_out, validation.folds, validation.excluded) == (len(q), 5, 0)
    assert validation.nominal is not None
    assert validation.identified.rotation_rms is not None
    assert validation.nominal.rotation_rms is not None
    said = [w.code for w in found.warnings]
    assert ("no_better_than_nominal" in said) == (
        validation.identified.position_rms_mm > validation.nominal.position_rms_mm
    )
    # Three coordinates of the robot's scatter. The camera goes round axis 4 at 120 mm, which circles are poor at.
    ratio = validation.identified.position_rms_mm / (math.sqrt(3.0) * 0.05)
    if method == "cpa":
        assert 0.9 < ratio < 10.0
    else:
        assert 0.9 < ratio < 1.4
        assert validation.identified.position_rms_mm < 0.7 * validation.nominal.position_rms_mm
        assert validation.identified.rotation_rms < validation.nominal.rotation_rms
    # Not asked for, it is not made.
    assert identify_from_axes(measure_poses(arm, q, rng, robot=ROBOT), KR5_ARC, method).validation is None


def test_poses_that_no_arm_explains_are_counted() -> None:
    rng = np.random.default_rng(22)
    arm = kr5_arc(rng)
    poses = measure_poses(arm, SWEEPS, rng, robot=ROBOT)
    assert poses.rotations is not None
    wrong = [3, 20, 41]
    positions, rotations = poses.positions_mm.copy(), poses.rotations.copy()
    positions[wrong] += [5.0, -8.0, 3.0]
    rotations[wrong[0]] = so3_exp(np.array([0.0, 0.1, 0.0])) @ rotations[wrong[0]]
    spoilt = replace(poses, positions_mm=positions, rotations=rotations)
    found = identify_from_axes(spoilt, KR5_ARC, folds=5)
    assert found.validation is not None
    assert (found.validation.held_out, found.validation.excluded) == (len(poses) - 3, 3)
    assert found.validation.identified.position_rms_mm < 0.2


def test_positions_alone_and_two_targets() -> None:
    rng = np.random.default_rng(23)
    arm = kr5_arc(rng)
    alone = replace(measure_poses(arm, SWEEPS, rng, robot=ROBOT), rotations=None)
    found = identify_from_axes(alone, KR5_ARC, folds=5)
    assert found.validation is not None
    assert found.validation.identified.rotation_rms is None
    assert found.validation.identified.position_rms_mm < 0.2
    q = np.concatenate([SWEEPS, SWEEPS[:18]])
    target = np.repeat([0, 1, 1], [27, 27, 18])
    both = measure_poses(arm, q, rng, robot=ROBOT, target=target)
    found = identify_from_axes(both, KR5_ARC, folds=5)
    assert found.validation is not None
    assert found.validation.held_out == len(q)
    assert found.validation.identified.position_rms_mm < 0.2


def test_arcs_that_hang_on_every_pose_leave_none_to_hold_out() -> None:
    rng = np.random.default_rng(24)
    arm = kr5_arc(rng)
    q = sweep_angles(KR5_ARC_HOME, steps=3)
    found = identify_from_axes(measure_poses(arm, q, rng, robot=ROBOT), KR5_ARC, folds=5)
    assert found.validation is None
