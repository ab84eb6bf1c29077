"""What a session's camera is on."""

from __future__ import annotations

import enum


class CameraMount(enum.StrEnum):
    """On the robot, before a fixed target; or fixed, the target on the robot's flange."""

    robot = "robot"
    fixed = "fixed"
