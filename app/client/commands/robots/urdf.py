"""A URDF's chain of revolute joints as nominal Denavit-Hartenberg parameters, with β where axes are nearly parallel.

The chain leads from the root to the link `tool0`, to `flange`, or to the only end with the most joints. Lengths of a
URDF are metres, angles rad; those here are mm and rad.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

from ... import Json
from ...pose_rows import decoded
from ..record_files import FileRefused
from ..rotations import Frame, applied, from_roll_pitch_yaw, from_vector
from .screw_axes import Axis, DhRow, dh_of_axes, unit

_MM_PER_M = 1000.0
_MAX_JOINTS = 12
_ENDS = ("tool0", "flange")
_NOMINAL_STEP = math.radians(15.0)
_ROUNDED_RAD = 5e-5  # files have 1.5708 for π/2
_FINEST_RAD = 1e-7  # single precision has it, and over metres it is below a micrometre
_TURNING = ("revolute", "continuous")


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint of the file: its fixed transform, its axis in its own frame, and limits in rad."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Frame
    axis: list[float]
    limits: tuple[float, float] | None
    mimics: bool


@dataclass(frozen=True, slots=True)
class UrdfRobot:
    """What a URDF says of an arm: fields of a robot's joints, and how far they are from the file at most, mm.

    `T_base_dh` is frame 0 in the frame of the link `base`, and `T_last_end` the link `end` in the last frame.
    """

    name: str
    joints: list[Json]
    base: str
    end: str
    T_base_dh: Frame
    T_last_end: Frame
    deviation_mm: float


def read_urdf(path: Path) -> UrdfRobot:
    """Return the arm of a URDF. Raises FileRefused where the file is no URDF, or holds no chain of revolute joints."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileRefused(f"{path} cannot be read: {error}.") from error
    return parse_urdf(decoded(data))


def parse_urdf(text: str) -> UrdfRobot:
    """`read_urdf` of a file's content."""
    robot = _parsed(text)
    every = [_joint(element) for element in robot.findall("joint")]
    chain = _chain(every)
    frame, axes = Frame(), list[Axis]()
    for joint in chain:
        frame = frame @ joint.origin
        if joint.kind in _TURNING:
            axes.append(Axis(frame.position_mm, applied(frame.rotation, joint.axis)))
    rows, T_root_dh = dh_of_axes(axes, frame)
    turning = [joint for joint in chain if joint.kind in _TURNING]
    joints = [_fields(row, joint) for row, joint in zip(rows, turning, strict=True)]
    T_last_end, deviation_mm = _compared(chain, rows, T_root_dh)
    base, T_root_base = _controller_base(every, chain[0].parent)
    T_base_dh = T_root_base.inverse() @ T_root_dh
    name = robot.get("name") or "robot"
    return UrdfRobot(name, joints, base, chain[-1].child, T_base_dh, T_last_end, deviation_mm)


def _parsed(text: str) -> ElementTree.Element:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise FileRefused("The file declares entities, which no URDF needs.", "Remove its <!DOCTYPE ...>.")
    try:
        robot = ElementTree.fromstring(text)  # noqa: S314 - entities are refused above
    except ElementTree.ParseError as error:
        raise FileRefused(f"The file is not XML: {error}.", "Give a URDF.") from error
    for element in robot.iter():  # a default namespace is in every name
        element.tag = element.tag.rpartition("}")[2] if "xacro" not in element.tag else element.tag
    if robot.tag != "robot":
        raise FileRefused(
            f"The file is no URDF: it begins with <{robot.tag}>.", "Give a file with <robot ...>."
        )
    if any("xacro" in element.tag for element in robot.iter()) or "${" in text:
        raise FileRefused("The file is a xacro, not yet a URDF.", "Expand it: xacro FILE.xacro > FILE.urdf.")
    return robot


def _joint(element: ElementTree.Element) -> UrdfJoint:
    name = element.get("name") or "?"
    origin, limit, axis = element.find("origin"), element.find("limit"), element.find("axis")
    links = [
        found.get("link") if found is not None else None for found in map(element.find, ("parent", "child"))
    ]
    if None in links:
        raise FileRefused(f"Joint {name} has no parent or no child link.")
    xyz = [float(part) for part in _numbers(name, origin, "xyz")]
    rpy = [_unrounded(part) for part in _numbers(name, origin, "rpy")]
    direction = [1.0, 0.0, 0.0] if axis is None else [float(part) for part in _numbers(name, axis, "xyz")]
    if not any(direction):
        raise FileRefused(
            f"The axis of joint {name} has no direction.",
            'Write the axis it turns about: <axis xyz="0 0 1"/>.',
        )
    limits = None
    if limit is not None and limit.get("lower") and limit.get("upper"):
        low, high = (_number(name, limit.get(end) or "") for end in ("lower", "upper"))
        limits = (low, high) if low < high else None
    return UrdfJoint(
        name,
        element.get("type") or "",
        str(links[0]),
        str(links[1]),
        Frame(from_roll_pitch_yaw(*rpy), [_MM_PER_M * value for value in xyz]),
        unit(direction),
        limits if element.get("type") == "revolute" else None,
        element.find("mimic") is not None,
    )


def _numbers(joint: str, element: ElementTree.Element | None, attribute: str) -> list[str]:
    """Return the three numbers of an attribute as they are written."""
    text = None if element is None else element.get(attribute)
    parts = ["0"] * 3 if text is None else text.split()
    for part in parts:
        _number(joint, part)
    if len(parts) != 3:
        raise FileRefused(f"Joint {joint} has no three numbers in {attribute}: {text}.")
    return parts


def _number(joint: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileRefused(f"Joint {joint} has no number in {text[:40]!r}.")
    return value


def _unrounded(text: str) -> float:
    """Return an angle; the exact one where it is a multiple of 15° that was rounded to the digits that are written.

    An identified arm has angles as near to a quarter turn, with all their digits.
    """
    angle = float(text)
    nominal = _NOMINAL_STEP * round(angle / _NOMINAL_STEP)
    exponent = Decimal(text).as_tuple().exponent
    last_digit = 10.0**exponent if isinstance(exponent, int) else 0.0
    return nominal if abs(angle - nominal) < max(min(_ROUNDED_RAD, last_digit), _FINEST_RAD) else angle


def _chain(joints: Sequence[UrdfJoint]) -> list[UrdfJoint]:
    """Return the joints from the root to the end, fixed ones too."""
    above = {joint.child: joint for joint in joints}
    if twice := next((joint for joint in joints if above[joint.child] is not joint), None):
        raise FileRefused(
            f"Link {twice.child} hangs on joints {twice.name} and {above[twice.child].name}.",
            "Give each link one parent.",
        )
    parents = {joint.parent for joint in joints}
    chains = {joint.child: _upwards(joint, above) for joint in joints}
    counts = {end: sum(joint.kind != "fixed" for joint in chain) for end, chain in chains.items()}
    most = max(counts.values(), default=0)
    if not most:
        raise FileRefused("The file has no joint that turns.", "Give the URDF of an arm.")
    ends = [end for end in chains if counts[end] == most and (end not in parents or _is_end(end))]
    chosen = next((end for name in _ENDS for end in ends if _is_end(end, name)), None)
    if chosen is None:
        if len({chains[end][-1].child if not end else _last_turning(chains[end]) for end in ends}) > 1:
            raise FileRefused(
                f"The file has several chains of {most} joints, to {', '.join(sorted(ends))}.",
                "Name the link at the flange of the arm `tool0`, or give a file of the arm alone.",
            )
        chosen = min(ends, key=lambda end: len(chains[end]))
    chain = chains[chosen]
    for joint in chain:
        if joint.mimics or joint.kind not in (*_TURNING, "fixed"):
            kind = "follows another joint" if joint.mimics else f"is {joint.kind or 'of no type'}"
            raise FileRefused(
                f"Joint {joint.name} {kind}; only revolute joints have the parameters of a robot here.",
                "Measure with this joint at one travel, and state it in the file: type fixed, with the travel in its "
                "origin; send the angles of the other joints alone."
                if joint.kind == "prismatic"
                else "Give the URDF of an arm with revolute joints alone.",
            )
    if most > _MAX_JOINTS:
        raise FileRefused(f"The chain has {most} joints; a robot has at most {_MAX_JOINTS}.")
    return chain


def _upwards(joint: UrdfJoint, above: dict[str, UrdfJoint]) -> list[UrdfJoint]:
    found = [joint]
    while (parent := above.get(found[0].parent)) is not None:
        if len(found) > len(above):
            raise FileRefused("The links of the file form a ring, not a tree.")
        found.insert(0, parent)
    return found


def _last_turning(chain: Sequence[UrdfJoint]) -> str:
    return next(joint.name for joint in reversed(chain) if joint.kind != "fixed")


def _is_end(link: str, name: str | None = None) -> bool:
    """Return whether a link is the arm's end by its name, whatever prefix it has."""
    return any(re.search(rf"(^|[_/]){one}$", link) for one in ((name,) if name else _ENDS))


def _fields(row: DhRow, joint: UrdfJoint) -> Json:
    fields: Json = {
        "name": joint.name,
        "a_mm": row.a,
        "alpha_deg": round(math.degrees(row.alpha), 7),
        "d_mm": row.d,
        "theta_offset_deg": round(math.degrees(row.offset), 7),
    }
    if row.beta:
        fields["beta_deg"] = round(math.degrees(row.beta), 7)
    if joint.limits is not None:
        low, high = (round(math.degrees(limit), 4) for limit in joint.limits)
        fields |= {"minimum_deg": low, "maximum_deg": high}
    return fields


def _controller_base(joints: Sequence[UrdfJoint], root: str) -> tuple[str, Frame]:
    """Return the link that stands for the controller's base, in the root's frame: `base` (ROS REP 199), or the root."""
    above = {joint.child: joint for joint in joints}
    for joint in joints:
        way = _upwards(joint, above)
        if (
            re.search(r"(^|[_/])base$", joint.child)
            and way[0].parent == root
            and all(one.kind == "fixed" for one in way)
        ):
            return joint.child, _file_flange(way, [])
    return root, Frame()


def _compared(chain: Sequence[UrdfJoint], rows: Sequence[DhRow], T_root_dh: Frame) -> tuple[Frame, float]:
    """Return the file's end in the last frame, and by how much it moves otherwise over several postures, mm."""
    postures = [[0.9 * math.sin(1.7 * k * (j + 1) + k) for j in range(len(rows))] for k in range(8)]
    T_last_end: Frame | None = None
    largest = 0.0
    for angles in postures:
        file = _file_flange(chain, angles)
        found = T_root_dh
        for row, angle in zip(rows, angles, strict=True):
            found = found @ row.frame(angle)
        if T_last_end is None:
            T_last_end = found.inverse() @ file
        expected = found @ T_last_end
        largest = max(largest, math.dist(expected.position_mm, file.position_mm))
    assert T_last_end is not None
    return T_last_end, largest


def _file_flange(chain: Sequence[UrdfJoint], angles: Sequence[float]) -> Frame:
    frame, left = Frame(), list(angles)
    for joint in chain:
        frame = frame @ joint.origin
        if joint.kind in _TURNING:
            angle = left.pop(0)
            frame = frame @ Frame(from_vector([angle * value for value in joint.axis]))
    return frame
