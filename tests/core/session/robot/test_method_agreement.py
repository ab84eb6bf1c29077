"""Methods are compared as descriptions of one arm, whichever of two equal ones each has taken."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from core.geometry import so3_exp, transform
from core.kinematics import Chain, find_sweeps, identify, nearest_description, with_reversals
from core.kinematics.pose_observations import PoseData
from core.session.robot.method_agreement import compare_methods, disagreements
from core.simulation.arm import Arm

TWO_AXES = Chain.from_rows([(0.7, 90.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
TOLERANCE = math.radians(0.02)


def test_reversed_axes_are_no_disagreement() -> None:
    """A positioner whose axes pass at .7 mm: without a nominal robot a hair decides about the sense of x."""
    rng = np.random.default_rng(4)
    base = transform(so3_exp(rng.normal(0.0, 1.0, 3)), rng.normal(0.0, 500.0, 3))
    arm = Arm(
        TWO_AXES, base[None], transform(so3_exp(rng.normal(0.0, 1.0, 3)), np.array([200.0, 50.0, 150.0]))
    )
    q = np.zeros((26, 2))
    q[:13, 0] = q[13:, 1] = np.linspace(-1.5, 1.5, 13)
    T = arm.camera_poses(q)
    rotations = np.array([so3_exp(rng.normal(0.0, 1e-4, 3)) @ R for R in T[:, :3, :3]])
    poses = PoseData(q, T[:, :3, 3] + rng.normal(0.0, 0.1, (26, 3)), rotations)
    found, sweeps = identify(poses, folds=0).joints, find_sweeps(poses)
    P = Chain(tuple(joint.parameters for joint in found)).as_array()
    reversed_chain = Chain.from_array(with_reversals(P, np.array([True])))
    assert nearest_description(reversed_chain.as_array(), P).tolist() == [True]
    others = [
        replace(joint, parameters=parameters)
        for joint, parameters in zip(found, reversed_chain.joints, strict=True)
    ]
    plain = compare_methods(found, poses, None, sweeps, TOLERANCE)
    turned = compare_methods(others, poses, None, sweeps, TOLERANCE)
    assert all(one.largest is not None and one.largest < 3.0 for one in plain)
    assert [one.largest for one in turned] == pytest.approx([one.largest for one in plain], rel=1e-6)
    assert not list(disagreements(turned))
