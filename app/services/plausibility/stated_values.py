"""Lengths and angles that are almost surely in another unit than their names say: metres, radians, millimetres for
micrometres, shares of the image for pixels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from app.errors import InvalidContent

MAX_ERRORS = 100
MIN_PITCH_MM = 0.2
"""No grid is printed so finely; 0.025 is 25 mm in metres."""
MIN_LINK_MM = 5.0
"""Of the longest length a or d: no arm is as short."""
MAX_PARALLEL = 0.2
"""Sine of the angle between axes that count as nearly parallel, and may have β: beyond it analyses take their common
normal (`core.kinematics.dh`)."""
MAX_RADIANS = 7.0
"""Just above 2 π: angles in radians are smaller, and a robot's limits in degrees are not."""
MIN_REACH_MM = 5.0
"""No flange stays so near the origin of its robot's base."""
MAX_HALF_TURN = 3.2
"""Just above π: roll, pitch and yaw in radians are smaller."""
MIN_REPEATABILITY_MM = 0.001
"""No arm repeats to a micrometre; 0.00002 is 0.02 mm in metres."""
MIN_FOCAL_LENGTH_MM = 0.3
"""No lens is as short, and in metres only a telephoto lens is longer."""
MIN_PIXEL_PITCH_UM = 0.3
"""No pixel is as small; 0.0055 is 5.5 µm in millimetres."""
_MAX_PIXEL_PITCH_IN_M = 1e-4
MIN_FOCAL_PX = 10.0
MIN_FOCAL_SHARE = 0.1
"""Of the principal point's coordinates: a lens that sees 168° from edge to edge is longer."""
_PIXEL_UM = 5.0
"""Of the guess of what a focal length in millimetres is in pixels."""
_IMAGE_PX = 640
"""Width of the image in the guess of what a share of it is in pixels."""
_OTHER_UNITS = {"metres": 1000.0, "inches": 25.4, "centimetres": 10.0, "micrometres": 0.001}
_UNIT_TOLERANCE = 0.2
"""Of the ratio of a certificate's pitch and the nominal one; a print that is off by more is of another pitch."""
_QUARTER_TURN_TOLERANCE = 0.01
_TYPED_QUARTER_TURN_TOLERANCE = 0.0015
"""Of a value typed with three decimals: 1.57, 1.571, 3.142."""
_ADVICE = (
    "Lengths are in mm and angles in degrees. If the values are right, send them with accept_implausible=true "
    "(--accept-implausible)."
)
_CAMERA_ADVICE = (
    "A focal length is in mm in lens and in pixels in intrinsics, a pixel pitch in µm. If the values are right, send "
    "them with accept_implausible=true (--accept-implausible)."
)


def check_pitch(pitch_mm: float) -> None:
    """Raise InvalidContent (`implausible_unit`) for a pitch that looks like metres."""
    if pitch_mm < MIN_PITCH_MM:
        raise implausible(
            "metres",
            _in_metres([("pitch_mm", pitch_mm)]),
        )


def check_joints(joints: Sequence[Mapping[str, Any]]) -> None:
    """Raise InvalidContent (`implausible_unit`) for twists or limits that look like radians, links like metres."""
    angles = _in_radians(joints)
    if angles:
        raise implausible("radians", angles)
    lengths = [
        (f"joints.{place}.{name}", joint[name])
        for name in ("a_mm", "d_mm")
        for place, joint in enumerate(joints)
    ]
    small = [(field, length) for field, length in lengths if abs(length) < MIN_LINK_MM]
    links = [joint for joint in joints if abs(joint["a_mm"]) < MIN_LINK_MM]
    # An arm whose axes all cross has its lengths along them; each a is what workshops leave. Parallel axes are apart.
    apart = any(
        joint["a_mm"] and abs(math.sin(math.radians(joint["alpha_deg"]))) < MAX_PARALLEL for joint in links
    )
    if len(small) == len(lengths) or (len(links) == len(joints) and apart):
        metres = _in_metres(small)
        if metres:
            raise implausible("metres", metres)


def check_datasheet(robot: Mapping[str, Any]) -> None:
    """Raise InvalidContent (`implausible_unit`) for a repeatability or an accuracy that looks like metres."""
    small = [
        (name, robot[name])
        for name in ("datasheet_repeatability_mm", "datasheet_accuracy_mm")
        if robot.get(name) and robot[name] < MIN_REPEATABILITY_MM
    ]
    if small:
        raise implausible("metres", _in_metres(small))


def check_lens(lens: Mapping[str, float] | None) -> None:
    """Raise InvalidContent (`implausible_unit`) for a focal length in metres, a pixel pitch in mm or metres."""
    if lens is None:
        return
    focal_mm, pitch_um = lens["focal_length_mm"], lens["pixel_pitch_um"]
    if focal_mm < MIN_FOCAL_LENGTH_MM:
        raise implausible("metres", _in_metres([("lens.focal_length_mm", focal_mm)]), _CAMERA_ADVICE)
    if pitch_um < MIN_PIXEL_PITCH_UM:
        unit, factor = ("metres", 1e6) if pitch_um < _MAX_PIXEL_PITCH_IN_M else ("millimetres", 1e3)
        guess = f"{pitch_um:g} µm would be {factor * pitch_um:g} µm if it was stated in {unit}"
        raise implausible(unit, [("lens.pixel_pitch_um", guess)], _CAMERA_ADVICE)


def check_intrinsics(intrinsics: Mapping[str, float] | None) -> None:
    """Raise InvalidContent (`implausible_unit`) for focal lengths in mm, metres or shares of the image."""
    if intrinsics is None:
        return
    centre = max(abs(intrinsics["cx_px"]), abs(intrinsics["cy_px"]))
    small = [
        (f"intrinsics.{name}", intrinsics[name])
        for name in ("fx_px", "fy_px")
        if intrinsics[name] < max(MIN_FOCAL_PX, MIN_FOCAL_SHARE * centre)
    ]
    if not small:
        return
    if centre < MIN_FOCAL_PX:
        unit, factor, condition = (
            "shares of the image's width",
            float(_IMAGE_PX),
            f"of an image {_IMAGE_PX} px wide",
        )
    else:
        in_metres = small[0][1] < MIN_FOCAL_LENGTH_MM
        unit, mm = ("metres", 1000.0) if in_metres else ("millimetres", 1.0)
        factor, condition = (
            mm * 1000.0 / _PIXEL_UM,
            f"if it was stated in {unit}, with pixels of {_PIXEL_UM:g} µm",
        )
    errors = [(field, f"{value:g} px would be {factor * value:g} px {condition}") for field, value in small]
    raise implausible(unit, errors, _CAMERA_ADVICE)


def check_certificate(certificate: Mapping[str, Any] | None, pitch_mm: float, spaces: int) -> None:
    """Raise InvalidContent (`certificate_unit_mismatch`) for a certificate with the nominal lengths in another unit.

    Parameters
    ----------
    certificate
        With `pitch_x_mm` and `pitch_y_mm`, or `points_mm`, any of which may be null.
    pitch_mm
        The target's nominal pitch.
    spaces
        How many pitches the grid is long.
    """
    if certificate is None:
        return
    stated = [
        (f"certificate.{name}", certificate[name], pitch_mm)
        for name in ("pitch_x_mm", "pitch_y_mm")
        if certificate.get(name)
    ]
    if points := certificate.get("points_mm"):
        length = max(max(p[axis] for p in points) - min(p[axis] for p in points) for axis in (0, 1))
        stated.append(("certificate.points_mm", length, spaces * pitch_mm))
    for unit, factor in _OTHER_UNITS.items():
        found = [
            (field, f"{length:g} mm would be {factor * length:g} mm if it was stated in {unit}")
            for field, length, nominal in stated
            if abs(factor * length / nominal - 1.0) < _UNIT_TOLERANCE
        ]
        if found:
            field, message = found[0]
            raise InvalidContent(
                f"The certificate's lengths look like {unit}: {field}, {message}.",
                "State the certificate's lengths in mm, as the target's pitch.",
                code="certificate_unit_mismatch",
                errors=found[:MAX_ERRORS],
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
            raise implausible(unit, _in_metres(fields) if unit == "metres" else _as_radians(fields))


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
        if joint.get(name) is not None and joint.get("minimum_deg") != joint.get("maximum_deg")
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


def implausible(
    unit: str, errors: list[tuple[str, str]], advice: str = _ADVICE, why: str = ""
) -> InvalidContent:
    """Return the refusal of values that look like a unit; `why` follows the first of them."""
    field, message = errors[0]
    return InvalidContent(
        f"Values look like {unit}: {field}, {message}{why}.",
        advice,
        code="implausible_unit",
        errors=errors[:MAX_ERRORS],
    )
