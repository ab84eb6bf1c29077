"""Commands of a real UR10, corrected by a third of its poses and compared at the others."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from core.kinematics import Level, ModelChoice, correct, correction_model, identify
from tests.support.simulation.robots.arms import UR10
from tests.support.simulation.robots.ur10_tracker import tracked


def rms(errors: np.ndarray) -> float:
    return math.sqrt(float(np.mean(np.sum(errors**2, axis=1))))


@pytest.mark.slow
def test_corrected_commands_of_a_ur10_are_three_and_eight_times_nearer(data_folder: Path) -> None:
    poses = tracked(data_folder)
    part = np.arange(len(poses)) % 3 == 0
    found = identify(poses.take(np.flatnonzero(part)), UR10, model=ModelChoice.AUTO)
    rest = poses.take(np.flatnonzero(~part))
    assert found.error_model is not None
    assert found.nominal_arm is not None
    # Where the arm was is known at its stated angles: a corrected command is off by what the model is off there.
    limits = {False: (Level.COMPLIANCE, 0.42), True: (Level.ALL, 0.15)}
    for curves, (level, most) in limits.items():
        by = correction_model(found.error_model, found.nominal_arm, found.validation, curves=curves)
        uncorrected = rms(rest.positions_mm - by.meant(rest.joint_angles)[:, :3, 3])
        corrected = rms(rest.positions_mm - by.attained(rest.joint_angles)[:, :3, 3])
        assert by.level is level
        assert corrected < most * uncorrected
        assert by.random.position_ratio == pytest.approx(corrected / uncorrected, rel=0.25)
        commands = correct(by, rest.joint_angles[:100])
        assert np.mean(commands.applied) > 0.9
        stated = math.sqrt(float(np.nanmean(commands.expected[0] ** 2)))
        assert 0.6 < stated / corrected < 1.6
