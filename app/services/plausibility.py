"""Lengths and angles that are almost surely in another unit than their names say: metres, radians."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from app.errors import InvalidContent

MIN_PITCH_MM = 0.2
"""No grid is printed so finely; 0.025 is 25 mm in metres."""
MIN_LINK_MM = 5.0
"""Of the longest link: no arm is as short."""
MAX_RADIANS = 7.0
"""Just above 2 π: angles in radians are smaller, and a robot's limits in degrees are not."""
_QUARTER_TURN_TOLERANCE = 0.01


def check_pitch(pitch_mm: float) -> None:
    """Raise InvalidContent (`implausible_unit`) for a pitch that looks like metres."""
    if pitch_mm < MIN_PITCH_MM:
        raise _implausible(
            "metres",
            [("pitch_mm", f"{pitch_mm:g} mm would be {1000.0 * pitch_mm:g} mm if it was stated in metres")],
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
            [
                (f"joints.{place}.a_mm", f"{a:g} mm would be {1000.0 * a:g} mm if it was stated in metres")
                for place, a in enumerate(lengths)
                if a
            ],
        )


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
    return [
        (field, f"{angle:g}° would be {math.degrees(angle):.4g}° if it was stated in radians")
        for field, angle in found
        if angle
    ]


def _are_small(angles: Sequence[tuple[str, float]]) -> bool:
    return any(angle for _, angle in angles) and all(abs(angle) < MAX_RADIANS for _, angle in angles)


def _is_quarter_turn(angle: float) -> bool:
    turns = angle / (math.pi / 2.0)
    return round(turns) != 0 and abs(turns - round(turns)) < _QUARTER_TURN_TOLERANCE


def _implausible(unit: str, errors: list[tuple[str, str]]) -> InvalidContent:
    field, message = errors[0]
    return InvalidContent(
        f"Values look like {unit}: {field}, {message}.",
        "Lengths are in mm and angles in degrees. If the values are right, send them with accept_implausible=true "
        "(--accept-implausible).",
        code="implausible_unit",
        errors=errors,
    )
