"""From an instrument's records to readings as the service takes them: mm, degrees for joints, rotations as matrices."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from app.agent import Json
from app.cli.import_records import FileRefused, Record, Records

Array = np.ndarray[Any, np.dtype[np.float64]]

AXES = {"x": np.array([1.0, 0.0, 0.0]), "y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}
EULER = re.compile(r"[xyz]{3}")
FIELDS = (
    *("pose", "cycle", "joints"),
    *("x", "y", "z", "u_x", "u_y", "u_z"),
    *("rx", "ry", "rz", "r1", "r2", "r3", "u_rx", "u_ry", "u_rz", "u_r1", "u_r2", "u_r3"),
    *("qx", "qy", "qz", "qw"),
)
UNIT_TOLERANCE = 1e-3
_POSE = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,127}")
_NATIVE = ("pose_id", "cycle", "joint_angles_deg", "position_mm", "rotation", "covariance")


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where in a record what stands, and in which units.

    `columns` maps names of `FIELDS` to those of the file; those not named stand under the field's own name. `rotation`
    is how angles are meant: `xyz` and its like for R = Rx(rx) Ry(ry) Rz(rz) in the order written, each about the axes
    as already turned; `vector` for a rotation vector; None to take no orientation from angles.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    rotation: str | None = None
    length_mm: float = 1.0
    angle_rad: float = math.radians(1.0)
    joint_deg: float = 1.0
    decimal: str | None = None
    prefix: str = "r"


@dataclass(frozen=True, slots=True)
class Problem:
    """What is wrong with one record, and where it stands."""

    place: str
    message: str


class _Wrong(Exception):
    pass


def read_readings(records: Records, layout: Layout) -> tuple[list[tuple[str, Json]], list[Problem]]:
    """Return (place, reading) of every sound record, and what is wrong with the others.

    Raises FileRefused where the file as a whole does not suit the layout.
    """
    if not records.entries:
        raise FileRefused("The file holds no readings.")
    _check_columns(records, layout)
    decimal = layout.decimal or _decimal(records, layout)
    readings: list[tuple[str, Json]] = []
    problems = []
    for number, record in enumerate(records.entries, start=1):
        try:
            readings.append((record.place, _reading(record, number, layout, decimal)))
        except _Wrong as wrong:
            problems.append(Problem(record.place, str(wrong)))
    return readings, problems + _inconsistencies(readings)


def _check_columns(records: Records, layout: Layout) -> None:
    unknown = sorted(set(layout.columns) - set(FIELDS))
    if unknown:
        raise FileRefused(f"--column knows no {', '.join(unknown)}.", f"It knows {', '.join(FIELDS)}.")
    present = {name for record in records.entries for name in record.fields}
    if "position_mm" in present:
        return
    wanted = [c for name, column in layout.columns.items() for c in _columns_of(name, column)]
    wanted += [name for name in ("x", "y", "z") if name not in layout.columns]
    absent = [name for name in wanted if name not in present]
    if absent:
        raise FileRefused(
            f"The file has no {', '.join(absent)}. It has {', '.join(sorted(present))}.",
            "Say which columns hold what, e.g. --column x=measurement_x --column joints=q1,q2,q3.",
        )


def _columns_of(name: str, column: str) -> list[str]:
    return [part.strip() for part in column.split(",")] if name == "joints" else [column]


def _decimal(records: Records, layout: Layout) -> str:
    """Return the decimal sign of a CSV's numbers; raises FileRefused where both signs occur."""
    if records.delimiter in (None, ","):
        return "."
    columns = [
        c
        for name in FIELDS
        if name not in ("pose", "cycle")
        for c in _columns_of(name, layout.columns.get(name, name))
    ]
    cells = [str(record.fields.get(c, "")) for record in records.entries for c in columns]
    comma, point = any("," in cell for cell in cells), any("." in cell for cell in cells)
    if comma and point:
        raise FileRefused("Some numbers have a decimal comma and some a decimal point.", "Give --decimal.")
    return "," if comma else "."


def _reading(record: Record, number: int, layout: Layout, decimal: str) -> Json:
    if "position_mm" in record.fields:
        return _native(record)
    cell = _Cells(record, layout, decimal)
    rotation, turned = _orientation(cell, layout)
    position = [layout.length_mm * cell.number(name) for name in ("x", "y", "z")]
    return {
        "pose_id": _pose_id(cell, record, number, layout),
        "cycle": cell.cycle(),
        "joint_angles_deg": cell.joints(),
        "position_mm": position,
        "rotation": rotation.tolist() if rotation is not None else None,
        "covariance": _covariance(cell, layout, turned),
    }


def _native(record: Record) -> Json:
    """Return a record written as the service's own, whose checks say what is wrong with it."""
    unknown = sorted(set(record.fields) - {*_NATIVE, "id"})
    if unknown:
        raise _Wrong(f"a reading with position_mm has no {', '.join(unknown)}")
    if "pose_id" not in record.fields and record.name is None:
        raise _Wrong("has no pose_id")
    return {
        "pose_id": record.name,
        **{name: value for name, value in record.fields.items() if name in _NATIVE},
    }


@dataclass(frozen=True, slots=True)
class _Cells:
    """One record's values by the names of `FIELDS`."""

    record: Record
    layout: Layout
    decimal: str

    def has(self, name: str) -> bool:
        column = self.layout.columns.get(name, name)
        return column in self.record.fields and self.record.fields[column] not in ("", None)

    def number(self, name: str) -> float:
        return self._number(self.layout.columns.get(name, name))

    def text(self, name: str) -> str:
        return str(self.record.fields[self.layout.columns.get(name, name)])

    def cycle(self) -> int | None:
        if not self.has("cycle"):
            return None
        value = self.number("cycle")
        if value != int(value) or value < 1:
            raise _Wrong(f"{self.layout.columns.get('cycle', 'cycle')} is no cycle: {self.text('cycle')}")
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
            raise _Wrong(f"has no {column}")
        return self._as_number(column, self.record.fields[column])

    def _as_number(self, column: str, content: Any) -> float:
        if isinstance(content, bool) or content in (None, ""):
            raise _Wrong(f"{column} is empty" if not isinstance(content, bool) else f"{column} is no number")
        if isinstance(content, int | float):
            value = float(content)
        else:
            text = str(content).strip()
            text = text.replace(",", ".") if self.decimal == "," and "." not in text else text
            try:
                value = float(text.replace("_", "x"))
            except ValueError:
                raise _Wrong(f"{column} is no number: {str(content)[:40]!r}") from None
        if not math.isfinite(value):
            raise _Wrong(f"{column} is not finite")
        return value


def _pose_id(cell: _Cells, record: Record, number: int, layout: Layout) -> str:
    pose_id = f"{layout.prefix}{number}"
    if layout.columns.get("pose", "pose") in record.fields or "pose" in layout.columns:
        if not cell.has("pose"):
            raise _Wrong("has no pose")
        pose_id = cell.text("pose")
    elif record.name is not None:
        pose_id = record.name
    if not _POSE.fullmatch(pose_id):
        raise _Wrong(
            f"{pose_id[:40]!r} is no pose ID: 1-128 of letters, digits, '.', '_', '-', not beginning with a dot"
        )
    return pose_id


def _orientation(cell: _Cells, layout: Layout) -> tuple[Array | None, tuple[list[str], Array] | None]:
    """Return the rotation and, with angles, their names and what one radian of each does: w = E d(angles)."""
    if all(cell.has(name) for name in ("qx", "qy", "qz", "qw")):
        x, y, z, w = (cell.number(name) for name in ("qx", "qy", "qz", "qw"))
        norm = math.sqrt(x * x + y * y + z * z + w * w)
        if abs(norm - 1.0) > UNIT_TOLERANCE:
            raise _Wrong(f"its quaternion has the norm {norm:.6g}, not 1")
        return _from_quaternion(np.array([x, y, z, w]) / norm), None
    if layout.rotation is None:
        return None, None
    if layout.rotation == "vector":
        vector = layout.angle_rad * np.array([cell.number(name) for name in ("rx", "ry", "rz")])
        return _turn(vector), None
    sequence = layout.rotation
    numbered = ["r1", "r2", "r3"]
    names = numbered if cell.has("r1") or len(set(sequence)) < 3 else [f"r{axis}" for axis in sequence]
    angles = [layout.angle_rad * cell.number(name) for name in names]
    rotation, effect = np.eye(3), np.zeros((3, 3))
    for place, (axis, angle) in enumerate(zip(sequence, angles, strict=True)):
        effect[:, place] = rotation @ AXES[axis]
        rotation = rotation @ _turn(angle * AXES[axis])
    return rotation, (names, effect)


def _covariance(
    cell: _Cells, layout: Layout, turned: tuple[list[str], Array] | None
) -> list[list[float]] | None:
    """Return the covariance that the standard uncertainties of coordinates and angles amount to."""
    if not all(cell.has(name) for name in ("u_x", "u_y", "u_z")):
        return None
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag([(layout.length_mm * cell.number(f"u_{axis}")) ** 2 for axis in "xyz"])
    if turned is not None:
        names, effect = turned
        if not all(cell.has(f"u_{name}") for name in names):
            return None
        variances = [(layout.angle_rad * cell.number(f"u_{name}")) ** 2 for name in names]
        covariance[3:, 3:] = effect @ np.diag(variances) @ effect.T
    elif cell.has("qw") or layout.rotation is not None:
        return None  # nothing is said of the orientation, and zero would say that it is exact
    return [list(row) for row in ((covariance + covariance.T) / 2.0).tolist()]


def _turn(vector: Array) -> Array:
    """Rotate by |vector| rad about it (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * K + 2.0 * math.sin(angle / 2.0) ** 2 * (K @ K))


def _from_quaternion(q: Array) -> Array:
    x, y, z, w = q
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _inconsistencies(readings: Sequence[tuple[str, Json]]) -> list[Problem]:
    """Find what only shows between readings: other numbers of joints, cycles that come twice."""
    problems = []
    joints = next((len(r["joint_angles_deg"]) for _, r in readings if r.get("joint_angles_deg")), None)
    seen: dict[tuple[str, int], str] = {}
    for place, reading in readings:
        angles = reading.get("joint_angles_deg")
        if isinstance(angles, list) and len(angles) != joints:
            problems.append(Problem(place, f"has {len(angles)} joint angles, the first reading {joints}"))
        cycle = reading.get("cycle")
        if isinstance(cycle, int):
            key = (str(reading["pose_id"]), cycle)
            if key in seen:
                problems.append(Problem(place, f"is cycle {cycle} of pose {key[0]} again, as {seen[key]} is"))
            seen.setdefault(key, place)
    return problems
