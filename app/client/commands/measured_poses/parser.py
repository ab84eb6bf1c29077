"""Records of an instrument to measured poses of the service: mm, joint angles in degrees, rotations as matrices."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ... import Json
from ..record_files import FileRefused, Record, Records, refuse_mixed_signs
from ..rotations import Matrix, about, from_quaternion, from_vector, identity, product, transposed
from .layout import FIELDS, POSITION, QUATERNION, TEXTS, ColumnLayout, recognised

_MAX_NORM_ERROR = 1e-3
_POSE = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,127}")
_NATIVE = ("pose_id", "cycle", "joint_angles_deg", "position_mm", "rotation", "covariance")


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
    layout = recognised(records, layout)
    decimal = layout.decimal or _decimal(records, layout)
    poses: list[tuple[str, Json]] = []
    errors = []
    for number, record in enumerate(records.entries, start=1):
        try:
            poses.append((record.place, _pose(record, number, layout, decimal)))
        except _Invalid as invalid:
            errors.append(RowError(record.place, str(invalid)))
    return poses, errors if by_reflector else errors + _inconsistencies(poses)


def _decimal(records: Records, layout: ColumnLayout) -> str:
    """Return the decimal sign of a CSV's numbers; raises FileRefused where both signs occur."""
    if records.delimiter in (None, ","):
        return "."
    columns = [c for name in FIELDS if name not in ("cycle", *TEXTS) for c in layout.of(name)]
    refuse_mixed_signs(records, columns)
    cells = (str(record.fields.get(column, "")) for record in records.entries for column in columns)
    return "," if any("," in cell for cell in cells) else "."


def _pose(record: Record, number: int, layout: ColumnLayout, decimal: str) -> Json:
    if "position_mm" in record.fields:
        return _native(record)
    cell = _Cells(record, layout, decimal)
    rotation, by_angles = _orientation(cell, layout)
    position = [layout.length_mm * cell.number(name) for name in POSITION]
    return {
        "pose_id": _pose_id(cell, record, number, layout),
        "cycle": cell.cycle(),
        "joint_angles_deg": cell.joints(),
        "position_mm": position,
        "rotation": rotation,
        "covariance": _covariance(cell, layout, by_angles),
    }


def _native(record: Record) -> Json:
    """Return a record in the service's own form; shapes and ranges are for the service to validate."""
    unknown = sorted(set(record.fields) - {*_NATIVE, "id"})
    if unknown:
        raise _Invalid(f"a pose with position_mm has no field {', '.join(unknown)}")
    pose = {
        "pose_id": record.name,
        **{name: value for name, value in record.fields.items() if name in _NATIVE},
    }
    if pose["pose_id"] is None:
        raise _Invalid("has no pose_id")
    if not isinstance(pose["pose_id"], str):
        raise _Invalid(f"pose_id is read as {pose['pose_id']}, no text: put it in quotes")
    for name in _NATIVE[1:]:
        if pose.get(name) is not None:
            _check_numbers(name, pose[name])
    return pose


def _check_numbers(name: str, content: Any) -> None:
    """Raise _Invalid, which names the place, where something in a number or in lists of numbers is another value."""
    if isinstance(content, list):
        for place, one in enumerate(content):
            _check_numbers(f"{name}.{place}", one)
    elif isinstance(content, bool) or not isinstance(content, int | float) or not _is_finite(content):
        raise _Invalid(f"{name} is not a finite number: {str(content)[:40]!r}")


def _is_finite(number: float) -> bool:
    return abs(number) <= sys.float_info.max  # not for NaN, and whole numbers have no limit


@dataclass(frozen=True, slots=True)
class _Cells:
    """One record's values by the names of `FIELDS`."""

    record: Record
    layout: ColumnLayout
    decimal: str

    def has(self, name: str) -> bool:
        return all(self.record.fields.get(column) not in ("", None) for column in self.layout.of(name))

    def number(self, name: str) -> float:
        return math.fsum(map(self._number, self.layout.of(name)))

    def content(self, name: str) -> Any:
        return self.record.fields[self.layout.columns.get(name, name)]

    def text(self, name: str) -> str:
        return str(self.content(name))

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
        columns = self.layout.of("joints")
        if all(self.record.fields.get(name) in ("", None) for name in columns):
            return None
        values: list[float] = []
        for name in columns:
            content = self.record.fields.get(name)
            if isinstance(content, list):
                values += [self._as_number(f"{name}.{place}", one) for place, one in enumerate(content)]
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
        value = content
        if not isinstance(content, int | float):
            text = str(content).strip()
            text = text.translate({ord("."): "x", ord(","): "."}) if self.decimal == "," else text
            try:
                value = float(text.replace("_", "x"))
            except ValueError:
                raise _Invalid(f"{column} is not a number: {str(content)[:40]!r}") from None
        if not _is_finite(value):
            raise _Invalid(f"{column} is not finite: {str(content)[:40]}")
        return float(value)


def _pose_id(cell: _Cells, record: Record, number: int, layout: ColumnLayout) -> str:
    pose_id = f"{layout.prefix}{number}"
    if layout.columns.get("pose", "pose") in record.fields or "pose" in layout.columns:
        if not cell.has("pose"):
            raise _Invalid("has no pose")
        if isinstance(cell.content("pose"), bool):
            raise _Invalid(f"pose is read as {cell.text('pose')}: put it in quotes")
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
    if layout.rotation is None:
        return _of_quaternion(cell), None
    if layout.rotation == "none":
        return None, None
    names = list(layout.angles())
    if layout.rotation == "vector":
        return from_vector([layout.angle_rad * cell.number(name) for name in names]), None
    angles = [layout.angle_rad * cell.number(name) for name in names]
    rotation, columns = identity(), []
    for axis, angle in zip(layout.rotation, angles, strict=True):
        columns.append([row["xyz".index(axis)] for row in rotation])
        rotation = product(rotation, about(axis, angle))
    return rotation, (names, transposed(columns))


def _of_quaternion(cell: _Cells) -> Matrix | None:
    """Return the rotation of a quaternion; None for a record without one."""
    if not any(cell.has(name) for name in QUATERNION):
        return None
    x, y, z, w = (cell.number(name) for name in QUATERNION)
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if abs(norm - 1.0) > _MAX_NORM_ERROR:
        raise _Invalid(f"its quaternion has the norm {norm:.6g}, not 1")
    return from_quaternion(x, y, z, w)


def _covariance(
    cell: _Cells, layout: ColumnLayout, by_angles: tuple[list[str], Matrix] | None
) -> list[list[float]] | None:
    """Return the 6 x 6 covariance (mm, rad) of the standard uncertainties of coordinates and angles, or None."""
    if not all(cell.has(f"u_{axis}") for axis in POSITION):
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
    elif layout.rotation == "vector" or (layout.rotation is None and cell.has("qw")):
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
