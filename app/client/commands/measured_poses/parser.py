"""Records of an instrument to measured poses of the service: mm, joint angles in degrees, rotations as matrices."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ... import Json
from ..record_files import FileRefused, Record, Records
from ..rotations import Matrix, about, from_quaternion, from_vector, identity, product, transposed

EULER = re.compile(r"[xyz]{3}")
FIELDS = (
    *("pose", "cycle", "joints", "reflector"),
    *("x", "y", "z", "u_x", "u_y", "u_z"),
    *("rx", "ry", "rz", "r1", "r2", "r3", "u_rx", "u_ry", "u_rz", "u_r1", "u_r2", "u_r3"),
    *("qx", "qy", "qz", "qw"),
)
_TEXTS = ("pose", "reflector")
_MAX_NORM_ERROR = 1e-3
_POSE = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,127}")
_NATIVE = ("pose_id", "cycle", "joint_angles_deg", "position_mm", "rotation", "covariance")


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnLayout:
    """Columns of a file by field, units, and the convention of angles.

    `columns` maps names of `FIELDS` to columns of the file; the default column has the field's own name. `rotation` is
    the convention: a sequence such as `xyz` for R = Rx(rx) Ry(ry) Rz(rz), in this order about the rotated axes;
    `vector` for a rotation vector; None to ignore angles. `length_mm`, `angle_rad` and `joint_deg` are the units of
    coordinates, orientation angles and joint angles.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    rotation: str | None = None
    length_mm: float = 1.0
    angle_rad: float = math.radians(1.0)
    joint_deg: float = 1.0
    decimal: str | None = None
    prefix: str = "r"


@dataclass(frozen=True, slots=True)
class RowError:
    """What is wrong with one record, and its place in the file."""

    place: str
    message: str


class _Invalid(Exception):
    pass


def parse_poses(
    records: Records, layout: ColumnLayout, *, by_reflector: bool = False
) -> tuple[list[tuple[str, Json]], list[RowError]]:
    """Return (place, measured pose) of every valid record, and the errors of the others.

    With `by_reflector`, several records of one pose and cycle are no error. Raises FileRefused where the file as a
    whole does not match the layout.
    """
    if not records.entries:
        raise FileRefused("The file holds no poses.")
    _check_columns(records, layout)
    decimal = layout.decimal or _decimal(records, layout)
    poses: list[tuple[str, Json]] = []
    errors = []
    for number, record in enumerate(records.entries, start=1):
        try:
            poses.append((record.place, _pose(record, number, layout, decimal)))
        except _Invalid as invalid:
            errors.append(RowError(record.place, str(invalid)))
    return poses, errors if by_reflector else errors + _inconsistencies(poses)


def _check_columns(records: Records, layout: ColumnLayout) -> None:
    unknown = sorted(set(layout.columns) - set(FIELDS))
    if unknown:
        raise FileRefused(
            f"--column has no field {', '.join(unknown)}.", f"The fields are {', '.join(FIELDS)}."
        )
    present = {name for record in records.entries for name in record.fields}
    if "position_mm" in present:
        return
    wanted = [c for name, column in layout.columns.items() for c in _columns_of(name, column)]
    wanted += [name for name in ("x", "y", "z") if name not in layout.columns]
    absent = [name for name in wanted if name not in present]
    if absent:
        raise FileRefused(
            f"The file has no {', '.join(absent)}. It has {', '.join(sorted(present))}.",
            "Give the columns of the fields, e.g. --column x=measurement_x --column joints=q1,q2,q3.",
        )


def _columns_of(name: str, column: str) -> list[str]:
    """Return the columns that a field is of: joint angles one after the other, numbers as the sum of their columns."""
    parts = column.split("," if name == "joints" else "+")
    return [column] if name in _TEXTS else [part.strip() for part in parts]


def _decimal(records: Records, layout: ColumnLayout) -> str:
    """Return the decimal sign of a CSV's numbers; raises FileRefused where both signs occur."""
    if records.delimiter in (None, ","):
        return "."
    columns = [
        c
        for name in FIELDS
        if name not in ("cycle", *_TEXTS)
        for c in _columns_of(name, layout.columns.get(name, name))
    ]
    cells = [str(record.fields.get(c, "")) for record in records.entries for c in columns]
    comma, point = any("," in cell for cell in cells), any("." in cell for cell in cells)
    if comma and point:
        raise FileRefused("Some numbers have a decimal comma and some a decimal point.", "Give --decimal.")
    return "," if comma else "."


def _pose(record: Record, number: int, layout: ColumnLayout, decimal: str) -> Json:
    if "position_mm" in record.fields:
        return _native(record)
    cell = _Cells(record, layout, decimal)
    rotation, by_angles = _orientation(cell, layout)
    position = [layout.length_mm * cell.number(name) for name in ("x", "y", "z")]
    return {
        "pose_id": _pose_id(cell, record, number, layout),
        "cycle": cell.cycle(),
        "joint_angles_deg": cell.joints(),
        "position_mm": position,
        "rotation": rotation,
        "covariance": _covariance(cell, layout, by_angles),
    }


def _native(record: Record) -> Json:
    """Return a record in the service's own form, unchecked: the service validates it."""
    unknown = sorted(set(record.fields) - {*_NATIVE, "id"})
    if unknown:
        raise _Invalid(f"a pose with position_mm has no field {', '.join(unknown)}")
    if "pose_id" not in record.fields and record.name is None:
        raise _Invalid("has no pose_id")
    return {
        "pose_id": record.name,
        **{name: value for name, value in record.fields.items() if name in _NATIVE},
    }


@dataclass(frozen=True, slots=True)
class _Cells:
    """One record's values by the names of `FIELDS`."""

    record: Record
    layout: ColumnLayout
    decimal: str

    def has(self, name: str) -> bool:
        columns = _columns_of(name, self.layout.columns.get(name, name))
        return all(self.record.fields.get(column) not in ("", None) for column in columns)

    def number(self, name: str) -> float:
        return math.fsum(map(self._number, _columns_of(name, self.layout.columns.get(name, name))))

    def text(self, name: str) -> str:
        return str(self.record.fields[self.layout.columns.get(name, name)])

    def cycle(self) -> int | None:
        if not self.has("cycle"):
            return None
        value = self.number("cycle")
        if value != int(value) or value < 1:
            raise _Invalid(
                f"{self.layout.columns.get('cycle', 'cycle')} is not a cycle: {self.text('cycle')}"
            )
        return int(value)

    def joints(self) -> list[float] | None:
        column = self.layout.columns.get("joints", "joints")
        if "joints" not in self.layout.columns and column not in self.record.fields:
            return None
        values: list[float] = []
        for name in _columns_of("joints", column):
            content = self.record.fields.get(name)
            if isinstance(content, list):
                values += [self._as_number(name, one) for one in content]
            else:
                values.append(self._number(name))
        return [self.layout.joint_deg * value for value in values] or None

    def _number(self, column: str) -> float:
        if column not in self.record.fields:
            raise _Invalid(f"has no {column}")
        return self._as_number(column, self.record.fields[column])

    def _as_number(self, column: str, content: Any) -> float:
        if isinstance(content, bool) or content in (None, ""):
            raise _Invalid(
                f"{column} is empty" if not isinstance(content, bool) else f"{column} is not a number"
            )
        if isinstance(content, int | float):
            value = float(content)
        else:
            text = str(content).strip()
            text = text.replace(",", ".") if self.decimal == "," and "." not in text else text
            try:
                value = float(text.replace("_", "x"))
            except ValueError:
                raise _Invalid(f"{column} is not a number: {str(content)[:40]!r}") from None
        if not math.isfinite(value):
            raise _Invalid(f"{column} is not finite")
        return value


def _pose_id(cell: _Cells, record: Record, number: int, layout: ColumnLayout) -> str:
    pose_id = f"{layout.prefix}{number}"
    if layout.columns.get("pose", "pose") in record.fields or "pose" in layout.columns:
        if not cell.has("pose"):
            raise _Invalid("has no pose")
        pose_id = cell.text("pose")
    elif record.name is not None:
        pose_id = record.name
    if not _POSE.fullmatch(pose_id):
        raise _Invalid(
            f"{pose_id[:40]!r} is not a pose ID: 1-128 of letters, digits, '.', '_', '-', not beginning with a dot"
        )
    return pose_id


def _orientation(cell: _Cells, layout: ColumnLayout) -> tuple[Matrix | None, tuple[list[str], Matrix] | None]:
    """Return the rotation and, for angles, their names and the effect E of changing them: w = E d(angles), rad."""
    if all(cell.has(name) for name in ("qx", "qy", "qz", "qw")):
        x, y, z, w = (cell.number(name) for name in ("qx", "qy", "qz", "qw"))
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if abs(norm - 1.0) > _MAX_NORM_ERROR:
            raise _Invalid(f"its quaternion has the norm {norm:.6g}, not 1")
        return from_quaternion(x, y, z, w), None
    if layout.rotation is None:
        return None, None
    if layout.rotation == "vector":
        return from_vector([layout.angle_rad * cell.number(name) for name in ("rx", "ry", "rz")]), None
    sequence = layout.rotation
    numbered = ["r1", "r2", "r3"]
    names = numbered if cell.has("r1") or len(set(sequence)) < 3 else [f"r{axis}" for axis in sequence]
    angles = [layout.angle_rad * cell.number(name) for name in names]
    rotation, columns = identity(), []
    for axis, angle in zip(sequence, angles, strict=True):
        columns.append([row["xyz".index(axis)] for row in rotation])
        rotation = product(rotation, about(axis, angle))
    return rotation, (names, transposed(columns))


def _covariance(
    cell: _Cells, layout: ColumnLayout, by_angles: tuple[list[str], Matrix] | None
) -> list[list[float]] | None:
    """Return the 6 x 6 covariance (mm, rad) of the standard uncertainties of coordinates and angles, or None."""
    if not all(cell.has(name) for name in ("u_x", "u_y", "u_z")):
        return None
    covariance = [[0.0] * 6 for _ in range(6)]
    for place, axis in enumerate("xyz"):
        covariance[place][place] = (layout.length_mm * cell.number(f"u_{axis}")) ** 2
    if by_angles is not None:
        names, effect = by_angles
        if not all(cell.has(f"u_{name}") for name in names):
            return None
        variances = [(layout.angle_rad * cell.number(f"u_{name}")) ** 2 for name in names]
        weighted = [[e * v for e, v in zip(row, variances, strict=True)] for row in effect]
        for i, row in enumerate(product(weighted, transposed(effect))):
            covariance[3 + i][3:] = row
    elif cell.has("qw") or layout.rotation is not None:
        return None  # the orientation's uncertainty is unknown; zero would mean that it is exact
    return [[(covariance[i][j] + covariance[j][i]) / 2.0 for j in range(6)] for i in range(6)]


def _inconsistencies(poses: Sequence[tuple[str, Json]]) -> list[RowError]:
    """Find errors between poses: different numbers of joints, repeated cycles."""
    errors = []
    joints = next((len(r["joint_angles_deg"]) for _, r in poses if r.get("joint_angles_deg")), None)
    seen: dict[tuple[str, int], str] = {}
    for place, pose in poses:
        angles = pose.get("joint_angles_deg")
        if isinstance(angles, list) and len(angles) != joints:
            errors.append(RowError(place, f"has {len(angles)} joint angles, the first pose {joints}"))
        cycle = pose.get("cycle")
        if isinstance(cycle, int):
            key = (str(pose["pose_id"]), cycle)
            if key in seen:
                errors.append(RowError(place, f"repeats cycle {cycle} of pose {key[0]} in {seen[key]}"))
            seen.setdefault(key, place)
    return errors
