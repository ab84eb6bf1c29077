"""Frames whose pitch is near ±90° are named."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.geometry import rpy_to_rotation, transform
from core.session.frame_warnings import gimbal_warnings


def frame(pitch_deg: float) -> np.ndarray:
    return transform(
        rpy_to_rotation(np.array([0.3, math.radians(pitch_deg), -2.0])), np.array([1.0, 2.0, 3.0])
    )


@pytest.mark.parametrize(
    ("camera_deg", "targets_deg", "named"),
    [
        (0.0, [84.9], []),
        (0.0, [86.93], ["T_base_target (86.93"]),
        (-85.1, [0.0], ["T_flange_camera (-85.10"]),
        (10.0, [0.0, -90.0], ["T_base_target 2 (-90.00"]),
        (89.0, [88.0], ["T_flange_camera", "T_base_target"]),
    ],
)
def test_the_frames_near_the_singularity(
    camera_deg: float, targets_deg: list[float], named: list[str]
) -> None:
    found = gimbal_warnings(frame(camera_deg), [frame(one) for one in targets_deg])
    assert [one.code for one in found] == (["near_gimbal_lock"] if named else [])
    assert all(name in one.detail for one in found for name in named)


def test_of_a_fixed_camera_the_frames_have_their_own_names() -> None:
    (found,) = gimbal_warnings(frame(88.0), [frame(-89.0)], "fixed")
    assert "T_flange_target (88.00" in found.detail
    assert "T_base_camera (-89.00" in found.detail
