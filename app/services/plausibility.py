"""Lengths and angles that are almost surely in another unit than their names say: metres, radians."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from app.errors import InvalidContent

MAX_ERRORS = 100
MIN_PITCH_MM = 0.2
"""No grid is printed so finely; 0.025 is 25 mm in metres."""
MIN_LINK_MM = 5.0
"""Of the longest link: no arm is as short."""
MAX_RADIANS = 7.0
"""Just above 2 π: angles in radians are smaller, and a robot's limits in degrees are not."""
MIN_REACH_MM = 5.0
"""No flange stays so near the origin of its robot's base."""
MAX_HALF_TURN = 3.2
"""Just above π: roll, pitch and yaw in radians are smaller."""
_QUARTER_TURN_TOLERANCE = 0.01
_TYPED_QUARTER_TURN_TOLERANCE = 0.0015
"""Of a value typed with three decimals: 1.57, 1.571, 3.142."""


def check_pitch(pitch_mm: float) -> None:
    """Raise InvalidContent (`implausible_unit`) for a pitch that looks like metres."""
    if pitch_mm < MIN_PITCH_MM:
        raise _implausible(
            "metres",
            _in_metres([("pitch_mm", pitch_mm)]),
        )


def check_joints(joints: Sequence[Mapping[str, Any]]) -> None:
    """Raise InvalidContent (`implausible_unit`) for twists or limits that look like radians, links like metres."""
    angles = _in_radians(joints)
    if angles:
        raise _implausible("radians", angles)
    lengths = [joint["a_mm"] for joint in joints]
    if any(lengths) and all(abs(a) < MIN_LINK_MM for a in lengths):
        raise _implausible(
            "metres",
            _in_metres([(f"joints.{place}.a_mm", a) for place, a in enumerate(lengths)]),
        )


def check_commands(commands: Sequence[Mapping[str, Any]], *, in_list: bool = True) -> None:
    """Raise InvalidContent (`implausible_unit`) for commanded poses that look like metres or radians, all of them.

    Two poses or more are suspected by their size: no coordinate reaches 5 mm, no joint angle a full turn in radians.
    One by itself may well be small, and is suspected by a quarter turn in radians alone. Roll, pitch and yaw are
    always suspected by quarter turns, since a tool may stand upright at every pose.

    Parameters
    ----------
    commands
        `position_mm`, `joint_angles_deg`, `roll_deg`, `pitch_deg` and `yaw_deg`, each of which may be absent or null.
    in_list
        Whether fields are named by the place of their pose in the list.
    """
    for names, limit, unit in (
        (("position_mm",), MIN_REACH_MM, "metres"),
        (("joint_angles_deg",), MAX_RADIANS, "radians"),
        (("roll_deg", "pitch_deg", "yaw_deg"), MAX_HALF_TURN, "radians"),
    ):
        poses = _small_poses(commands, names, limit)
        several = len(poses) > 1
        tolerance = _QUARTER_TURN_TOLERANCE if several else _TYPED_QUARTER_TURN_TOLERANCE
        if several and "roll_deg" not in names:
            suspected = any(value for pose in poses for _, value in pose)
        else:
            suspected = unit == "radians" and any(
                _is_quarter_turn(value, tolerance) for pose in poses for _, value in pose
            )
        if suspected:
            fields = [
                (f"{place}.{name}" if in_list else name, value)
                for place, command in enumerate(commands)
                for name, value in _stated(command, names)
            ]
            raise _implausible(unit, _in_metres(fields) if unit == "metres" else _as_radians(fields))


def _small_poses(
    commands: Sequence[Mapping[str, Any]], names: Sequence[str], limit: float
) -> list[list[tuple[str, float]]]:
    """Return what every pose states that states something, and nothing as soon as one number reaches the limit."""
    poses = []
    for command in commands:
        numbers = _stated(command, names)
        if any(abs(value) >= limit for _, value in numbers):
            return []
        if numbers:
            poses.append(numbers)
    return poses


def _stated(command: Mapping[str, Any], names: Sequence[str]) -> list[tuple[str, float]]:
    """Return name and value of every number under these names, those of lists too."""
    found: list[tuple[str, float]] = []
    for name in names:
        value = command.get(name)
        if value is not None:
            found += [(name, number) for number in (value if isinstance(value, list) else (value,))]
    return found


def _in_radians(joints: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return the angles that look like radians: twists by their quarter turns, limits by their size."""
    twists = [(f"joints.{place}.alpha_deg", joint["alpha_deg"]) for place, joint in enumerate(joints)]
    limits = [
        (f"joints.{place}.{name}", joint[name])
        for place, joint in enumerate(joints)
        for name in ("minimum_deg", "maximum_deg")
        if joint.get(name) is not None
    ]
    found = []
    if _are_small(twists) and any(_is_quarter_turn(angle) for _, angle in twists):
        found += twists
    if _are_small(limits):
        found += limits
    return _as_radians(found)


def _in_metres(lengths: Sequence[tuple[str, float]]) -> list[tuple[str, str]]:
    return [
        (field, f"{length:g} mm would be {1000.0 * length:g} mm if it was stated in metres")
        for field, length in lengths
        if length
    ]


def _as_radians(angles: Sequence[tuple[str, float]]) -> list[tuple[str, str]]:
    return [
        (field, f"{angle:g}° would be {math.degrees(angle):.4g}° if it was stated in radians")
        for field, angle in angles
        if angle
    ]


def _are_small(angles: Sequence[tuple[str, float]]) -> bool:
    return any(angle for _, angle in angles) and all(abs(angle) < MAX_RADIANS for _, angle in angles)


def _is_quarter_turn(angle: float, tolerance: float = _QUARTER_TURN_TOLERANCE) -> bool:
    turns = angle / (math.pi / 2.0)
    return round(turns) != 0 and abs(turns - round(turns)) < tolerance


def _implausible(unit: str, errors: list[tuple[str, str]]) -> InvalidContent:
    field, message = errors[0]
    return InvalidContent(
        f"Values look like {unit}: {field}, {message}.",
        "Lengths are in mm and angles in degrees. If the values are right, send them with accept_implausible=true "
        "(--accept-implausible).",
        code="implausible_unit",
        errors=errors[:MAX_ERRORS],
    )
