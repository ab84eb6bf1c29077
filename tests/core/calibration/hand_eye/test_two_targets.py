"""Two targets before one robot: frames of their own, one camera."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.calibration.hand_eye import (
    HandEyeObservation,
    calibrate_hand_eye,
)
from core.errors import InvalidArgument
from core.geometry.se3 import so3_exp, so3_log, transform
from tests.support.simulation.hand_eye_poses import (
    T_BASE_TARGET,
    draw_stations,
    errors,
)

SECOND_TARGET = transform(so3_exp(np.array([2.7, -0.4, 0.1])), np.array([700.0, -420.0, 60.0]))


def before_two_targets(rng: np.random.Generator, count: int) -> list[HandEyeObservation]:
    """Draw stations every third of which is before a second target."""
    T_second_first = np.linalg.inv(SECOND_TARGET) @ T_BASE_TARGET
    found = []
    for i, s in enumerate(draw_stations(rng, count)):
        if i % 3 == 2:
            T = T_second_first @ s.T_target_camera
            turn = np.kron(np.eye(2), T_second_first[:3, :3])
            assert s.covariance is not None
            s = dataclasses.replace(s, T_target_camera=T, covariance=turn @ s.covariance @ turn.T, target=1)
        found.append(s)
    return found


def test_two_targets_have_frames_of_their_own_and_share_the_camera() -> None:
    trials, count = 40, 12
    rng = np.random.default_rng(21)
    inside = []
    for _ in range(trials):
        tie = calibrate_hand_eye(before_two_targets(rng, count))
        assert tie.covariance.shape == (18, 18)
        true, found = SECOND_TARGET, tie.T_base_targets[1]
        second = np.concatenate([true[:3, 3] - found[:3, 3], so3_log(true[:3, :3] @ found[:3, :3].T)])
        u = tie.coverage_factor * np.sqrt(np.diag(tie.covariance))
        inside.append(np.abs(np.concatenate([errors(tie), second])) < u)
    # 720 intervals in groups of 18 that share a fit: a standard error of some 1.3 %.
    assert 0.91 < np.mean(inside) < 0.99


def test_a_target_that_no_pose_is_before_is_refused() -> None:
    given = before_two_targets(np.random.default_rng(22), 6)
    with pytest.raises(InvalidArgument):
        calibrate_hand_eye([dataclasses.replace(s, target=2 * s.target) for s in given])
