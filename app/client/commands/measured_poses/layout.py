"""Columns of an instrument's file: which field each is, by the options or by its name, and which are not used.

A column that no option names is a field by its name, whatever its case and punctuation: `pose_id` and `Pose ID` are the
field pose, `X [mm]` is x. A name with a unit has to agree with the unit that the options state.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from ..record_files import FileRefused, Records

EULER = re.compile(r"[xyz]{3}")
CONVENTIONS = (
    "--rotation-format says how angles are applied: zyx for roll, pitch, yaw (R = Rz Ry Rx), xyz for R = Rx Ry Rz, or "
    "another order of three axes; vector for a rotation vector; none to store positions alone"
)
QUATERNION = ("qx", "qy", "qz", "qw")
POSITION = ("x", "y", "z")
_ANGLES = ("rx", "ry", "rz")
_NUMBERED = ("r1", "r2", "r3")
_MEASURED_LENGTHS = (*POSITION, *(f"u_{name}" for name in POSITION))
_MEASURED_TURNS = (*_ANGLES, *_NUMBERED, *(f"u_{name}" for name in (*_ANGLES, *_NUMBERED)))
FIELDS = ("pose", "cycle", "joints", "reflector", *_MEASURED_LENGTHS, *_MEASURED_TURNS, *QUATERNION)
TEXTS = ("pose", "reflector")
_ROLL_PITCH_YAW = {"rx": ("roll",), "ry": ("pitch",), "rz": ("yaw",)}
_LENGTHS, _TURNS = ("mm", "m", "in"), ("deg", "rad")
_SYNONYMS = {
    **{name: (name,) for name in FIELDS},
    "pose": ("pose", "pose_id", "poseid", "pose_name", "pose_no", "pose_number"),
    "cycle": ("cycle", "cycle_id", "cycle_no", "cycle_number", "repetition"),
    "joints": ("joints", "joint_angles", "joint_angles_deg"),
    **{name: (name, f"q_{name[1]}") for name in QUATERNION},
    **{name: (name, *(f"{name}_{unit}" for unit in _LENGTHS)) for name in _MEASURED_LENGTHS},
    **{
        name: tuple(
            f"{one}{unit}" for one in (name, *_ROLL_PITCH_YAW.get(name, ())) for unit in ("", "_deg", "_rad")
        )
        for name in _MEASURED_TURNS
    },
}
_FIELD = {synonym: name for name, synonyms in _SYNONYMS.items() for synonym in synonyms}
_JOINT = re.compile(r"(?P<stem>j_?|joint_?)(?P<number>[1-9][0-9]?)(?P<unit>_deg|_rad)?")


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnLayout:
    """Columns of a file by field, units, and the convention of angles.

    `columns` maps names of `FIELDS` to columns of the file; the default column has the field's own name. `rotation` is
    the convention: a sequence such as `xyz` for R = Rx(rx) Ry(ry) Rz(rz), in this order about the rotated axes;
    `vector` for a rotation vector; `none` for positions alone; None where the file has no angles, or quaternions.
    `length_mm`, `angle_rad` and `joint_deg` are the units of coordinates, orientation angles and joint angles.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    rotation: str | None = None
    length_mm: float = 1.0
    angle_rad: float = math.radians(1.0)
    joint_deg: float = 1.0
    decimal: str | None = None
    prefix: str = "r"

    def of(self, name: str) -> list[str]:
        """Return the columns that a field is of: joint angles one after the other, numbers as the sum of theirs."""
        column = self.columns.get(name, name)
        parts = column.split("," if name == "joints" else "+")
        return [column] if name in TEXTS else [part.strip() for part in parts]

    def angles(self) -> tuple[str, ...]:
        """Return the fields of the angles in the order of the convention."""
        if self.rotation in (None, "none"):
            return ()
        if self.rotation == "vector":
            return _ANGLES
        assert self.rotation is not None
        if "r1" in self.columns or len(set(self.rotation)) < len(_ANGLES):
            return _NUMBERED
        return tuple(f"r{axis}" for axis in self.rotation)


def recognised(records: Records, layout: ColumnLayout) -> ColumnLayout:
    """Return the layout with the columns that the file's names and the options give, and with its convention.

    Raises FileRefused where a column may be several fields or several columns one field, where a needed one is absent,
    and where nothing says what angles mean.
    """
    unknown = sorted(set(layout.columns) - set(FIELDS))
    if unknown:
        raise FileRefused(
            f"--column has no field {', '.join(unknown)}.", f"The fields are {', '.join(FIELDS)}."
        )
    present = _present(records)
    if "position_mm" in present:
        return layout
    named = _by_name(present, layout)
    if "joints" not in {*named, *layout.columns} and (joints := _numbered_joints(present)):
        named["joints"] = ",".join(joints)
    found = replace(layout, columns={**named, **layout.columns})
    _require(present, found, [*layout.columns, *POSITION])
    _check_units(found, named)
    return _with_convention(present, found)


def unused_columns(records: Records, layout: ColumnLayout, *, by_reflector: bool = False) -> list[str]:
    """Return the file's columns that say nothing of the poses, for a recognised layout, in the file's order."""
    present = _present(records)
    if "position_mm" in present:
        return []
    fields = ["pose", "cycle", "joints", *POSITION, *layout.angles(), *_stated_uncertainties(layout)]
    fields += QUATERNION if layout.rotation is None else ()
    fields += ("reflector",) if by_reflector else ()
    used = {column for name in fields for column in layout.of(name)}
    return [column for column in present if column and column not in used]


def _present(records: Records) -> list[str]:
    return list(dict.fromkeys(name for record in records.entries for name in record.fields))


def _plain(column: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", column.lower()).strip("_")


def _by_name(present: Sequence[str], layout: ColumnLayout) -> dict[str, str]:
    """Return the columns of the fields that no option gives, by their names."""
    given = {column for name in layout.columns for column in layout.of(name)}
    found: dict[str, list[str]] = defaultdict(list)
    for column in present:
        name = _FIELD.get(_plain(column))
        if name is not None and name not in layout.columns and column not in given:
            found[name].append(column)
    for name, columns in found.items():
        if len(columns) > 1:
            raise FileRefused(
                f"The file has {' and '.join(columns)}, each of which may be {name}.",
                f"Name the one to read: --column {name}={columns[0]}.",
            )
    return {name: columns[0] for name, columns in found.items()}


def _numbered_joints(present: Sequence[str]) -> list[str]:
    """Return the columns j1, j2, ... (or j1_deg, joint_1, ...); none where names or numbers leave a choice."""
    matches = [(match, column) for column in present if (match := _JOINT.fullmatch(_plain(column)))]
    forms = {(match["stem"], match["unit"]) for match, _ in matches}
    columns = {int(match["number"]): column for match, column in matches}
    whole = sorted(columns) == [*range(1, len(matches) + 1)]
    return [columns[number] for number in sorted(columns)] if whole and len(forms) == 1 else []


def looks_like_joint(column: str) -> bool:
    """Return whether a column has a joint's name."""
    return _JOINT.fullmatch(_plain(column)) is not None


def _require(present: Sequence[str], layout: ColumnLayout, names: Sequence[str]) -> None:
    absent = [column for name in dict.fromkeys(names) for column in layout.of(name) if column not in present]
    if absent:
        raise FileRefused(
            f"The file has no {', '.join(absent)}. It has {', '.join(sorted(present))}.",
            "Give the columns of the fields, e.g. --column x=measurement_x --column joints=q1,q2,q3.",
        )


def _check_units(layout: ColumnLayout, named: Mapping[str, str]) -> None:
    """Raise FileRefused where a column that was found by its name has another unit there than the options state."""
    for name in named:
        option, stated = _stated_unit(name, layout)
        for column in layout.of(name):
            unit = _plain(column).rpartition("_")[2]
            if stated and unit in (*_LENGTHS, *_TURNS) and unit != stated:
                raise FileRefused(
                    f"{column} is in {unit} by its name, in {stated} by {option}.",
                    f"Give {option} {unit}; if the name is wrong, --column {name}={named[name]}.",
                )


def _stated_unit(name: str, layout: ColumnLayout) -> tuple[str, str]:
    if name in _MEASURED_LENGTHS:
        return "--length-unit", {1.0: "mm", 1000.0: "m"}.get(layout.length_mm, "in")
    if name in _MEASURED_TURNS:
        return "--angle-unit", "rad" if layout.angle_rad == 1.0 else "deg"
    return "--joint-angle-unit", ("deg" if layout.joint_deg == 1.0 else "rad") if name == "joints" else ""


def _with_convention(present: Sequence[str], layout: ColumnLayout) -> ColumnLayout:
    """Return the layout with the convention of the orientations that the file has."""
    has = [name for name in FIELDS if all(column in present for column in layout.of(name))]
    angles = [name for name in (*_ANGLES, *_NUMBERED) if name in has]
    quaternion = [name for name in QUATERNION if name in has]
    whole = len(quaternion) == len(QUATERNION)
    if layout.rotation == "none":
        return layout
    if layout.rotation is not None and (angles or not whole):
        _require(present, layout, layout.angles())
        return layout
    if quaternion and not whole:
        absent = next(name for name in QUATERNION if name not in quaternion)
        raise FileRefused(
            f"The file has {', '.join(quaternion)}, but no {absent}.",
            f"Name the missing column, e.g. --column {absent}=q4; or give --rotation-format none for positions alone.",
        )
    if whole or not angles:
        return replace(layout, rotation=None)
    if all(_is_turn(layout.columns.get(name, ""), turn) for name, (turn,) in _ROLL_PITCH_YAW.items()):
        return replace(layout, rotation="zyx")
    raise FileRefused(
        f"Nothing says what the angles in {', '.join(c for name in angles for c in layout.of(name))} mean.",
        f"{CONVENTIONS}.",
    )


def _is_turn(column: str, turn: str) -> bool:
    return re.fullmatch(rf"{turn}(_deg|_rad)?", _plain(column)) is not None


def _stated_uncertainties(layout: ColumnLayout) -> list[str]:
    """Return the fields that the covariance is made of; none where that of the position or orientation is unknown."""
    position = [f"u_{name}" for name in POSITION]
    turns = [f"u_{name}" for name in layout.angles()]
    whole = all(name in layout.columns for name in (*position, *turns))
    turned = layout.rotation == "vector" or (layout.rotation is None and "qw" in layout.columns)
    return [*position, *turns] if whole and not turned else []
