"""Poses whose values are almost surely in another unit than their columns say: metres, radians."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

_LEAST_REACH_MM = 5.0
"""A robot that never leaves a cube of 10 mm about its origin is stated in metres."""
_FULL_TURN_RAD = 6.5
_HALF_TURN_RAD = 3.2
_QUARTER_TURN_TOLERANCE = 0.01
_LEAST_POSES = 2


def implausible_unit(poses: Iterable[Mapping[str, Any]]) -> str | None:
    """Return what looks like another unit in poses with the fields of the API; None for nothing.

    `position_mm` is in mm, `joint_angles_deg`, `roll_deg`, `pitch_deg` and `yaw_deg` are in degrees. One pose by itself
    is never suspected: an arm may well begin at its origin.
    """
    listed = list(poses)
    positions = [pose["position_mm"] for pose in listed if pose.get("position_mm")]
    if _all_within(positions, _LEAST_REACH_MM):
        return "positions look like metres: all coordinates are below 5"
    joints = [pose["joint_angles_deg"] for pose in listed if pose.get("joint_angles_deg")]
    if _all_within(joints, _FULL_TURN_RAD):
        return "joint angles look like radians: all are below 6.5"
    names = ("roll_deg", "pitch_deg", "yaw_deg")
    turns = [[pose[name] for name in names if pose.get(name) is not None] for pose in listed]
    if _all_within(turns, _HALF_TURN_RAD) and any(
        _is_quarter_turn(angle) for pose in turns for angle in pose
    ):
        return "roll, pitch and yaw look like radians: all are below 3.2, with quarter turns among them"
    return None


def _all_within(poses: list[list[float]], limit: float) -> bool:
    """Return whether two poses or more have values, not all of them 0, and none is as large as `limit`."""
    numbers = [value for pose in poses for value in pose if isinstance(value, int | float)]
    return len(poses) >= _LEAST_POSES and any(numbers) and all(abs(value) < limit for value in numbers)


def _is_quarter_turn(angle: float) -> bool:
    turns = angle / (math.pi / 2.0)
    return round(turns) != 0 and abs(turns - round(turns)) < _QUARTER_TURN_TOLERANCE
