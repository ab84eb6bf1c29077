"""Rows of a table of poses as fields of the API: x_mm, y_mm, z_mm become position_mm, j1_deg, ... joint_angles_deg.

Tables of the service, which are read, too, have position_x_mm, position_y_mm, position_z_mm and one cell
joint_angles_deg.

Values that are almost surely in metres or radians are noticed here, too.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

POSE_FIELDS = ("pose_id", "position_mm", "roll_deg", "pitch_deg", "yaw_deg", "joint_angles_deg", "approach")
POSE_COLUMNS = "pose_id, x_mm, y_mm, z_mm, roll_deg, pitch_deg, yaw_deg, j1_deg, j2_deg, ..., approach"
ONE_DECIMAL_SIGN = "Write all numbers with one decimal sign, and none between thousands"
_AXES = ("x_mm", "y_mm", "z_mm")
_OTHER_NAMES = {f"position_{axis}": axis for axis in _AXES}
_LISTS = ("position_mm", "joint_angles_deg")
_FORMULA = ("=", "+", "-", "@")
"""Text that begins so has an apostrophe before it in tables of the service, against spreadsheets."""
_JOINT = re.compile(r"j([1-9][0-9]?)_deg")
_UNITLESS = re.compile(
    r"(?:(?P<length>position|(?:position_)?[xyz])|(?P<angle>roll|pitch|yaw|j[1-9][0-9]?|joint_angles))"
    r"(?:_(?:m|cm|in|rad))?"
)
_DELIMITERS = ";\t,"
_STATED_DELIMITER = re.compile(r'"?sep=([;\t,|])"?[;\t,|]*(?:\r\n|\r|\n)', re.IGNORECASE)
_LEAST_REACH_MM = 5.0
"""A robot that never leaves a cube of 10 mm about its origin is stated in metres."""
_FULL_TURN_RAD = 7.0
_HALF_TURN_RAD = 3.2
_QUARTER_TURN_TOLERANCE = 0.01
_LEAST_POSES = 2


def is_pose_column(name: str) -> bool:
    """Return whether a table of poses may have a column of this name."""
    return _OTHER_NAMES.get(name, name) in (*_AXES, *POSE_FIELDS) or _JOINT.fullmatch(name) is not None


def in_unit(name: str) -> str | None:
    """Return what to do with a column of a pose in another unit, or without one; None for any other."""
    match = _UNITLESS.fullmatch(name)
    if match is None:
        return None
    unit = "mm" if match["length"] else "deg"
    return f"State {name} in {unit} and name it {match['length'] or match['angle']}_{unit}"


class RowError(ValueError):
    """A row cannot be used; the message gives the reason."""


def csv_rows(text: str, delimiter: str | None = None) -> tuple[Any, str]:
    """Return the reader of a CSV from its header on, and its delimiter.

    Unless given, that is the one that a spreadsheet's line `sep=;` before the header states, else the one of
    semicolon, tab and comma that the header has most of.
    """
    stated = _STATED_DELIMITER.match(text)
    if delimiter is None:
        delimiter = stated[1] if stated else max(_DELIMITERS, key=text.partition("\n")[0].count)
    rows = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter)
    if stated:
        next(rows)
    return rows, delimiter


def decoded(data: bytes) -> str:
    """Return a text file's content: UTF-8, UTF-16 with its mark, else the encoding of spreadsheets on Windows."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def number_of(cell: str, *, comma: bool) -> float:
    """Return a cell's number, NaN for another text; with `comma`, its decimal sign may be a comma, too."""
    text = cell.replace(",", ".") if comma else cell
    try:
        return float(text) if "_" not in text else math.nan  # float takes 1_0 for 10
    except ValueError:
        return math.nan


def mixed_decimal_signs(numbers: Iterable[tuple[str, str, str]]) -> str | None:
    """Return which of a table's numbers have a comma and which a point; None where all have the same.

    Parameters
    ----------
    numbers
        Place, column and text of each. Where both signs occur, one of them may be between thousands: next to 812,5,
        1.234 may be 1234.
    """
    first: dict[str, str] = {}
    for place, column, text in numbers:
        for sign in ",.":
            if sign in text:
                first.setdefault(sign, f"{column} is {text} in {place}")
    return " and ".join(dict.fromkeys(first.values())) if len(first) > 1 else None


def check_decimal_signs(rows: Iterable[tuple[str, Mapping[str, str]]], delimiter: str | None) -> None:
    """Raise RowError where some numbers of a table have a decimal comma and some a point.

    `rows` are the cells of its poses by column, each row with its place in the file.
    """
    if delimiter == ",":
        return
    mixed = mixed_decimal_signs(
        (place, name, text)
        for place, cells in rows
        for name, cell in cells.items()
        for text in (_parts(cell, delimiter) if name in _LISTS else [cell] if _is_number(name) else ())
    )
    if mixed is not None:
        raise RowError(f"numbers have both a comma and a point: {mixed}. {ONE_DECIMAL_SIGN}")


def pose_of_cells(cells: Mapping[str, str], delimiter: str | None) -> dict[str, Any]:
    """Return the fields of a row's cells by the names of the API; an empty cell is a value that is not known.

    Parameters
    ----------
    cells
        Column to text. Columns that belong to no pose are kept as they are.
    delimiter
        Of the table; where it is no comma, numbers may have decimal commas.

    Raises
    ------
    RowError
        A cell is no number, or a joint angle or coordinate is missing among others.
    """
    filled = {_OTHER_NAMES.get(name, name): _unguarded(cell) for name, cell in cells.items() if cell}
    if len(filled) != sum(map(bool, cells.values())):
        raise RowError("a coordinate is there twice; give x_mm, y_mm and z_mm, or position_x_mm, ...")
    joints = sorted((int(match[1]), name) for name in filled if (match := _JOINT.fullmatch(name)))
    lists = {
        "position_mm": [name for name in _AXES if name in filled],
        "joint_angles_deg": [name for _, name in joints],
    }
    if [number for number, _ in joints] != list(range(1, len(joints) + 1)):
        raise RowError("a joint angle is missing; fill j1_deg to the last, or none")
    if len(lists["position_mm"]) not in (0, len(_AXES)):
        raise RowError("a coordinate is missing; fill x_mm, y_mm and z_mm, or none")
    pose: dict[str, Any] = {}
    for name, cell in filled.items():
        if name in _LISTS:
            if lists[name]:
                raise RowError(f"{name} is there twice, in one column and in several")
            pose[name] = [_number(part, name, delimiter) for part in _parts(cell, delimiter)]
        elif name not in _AXES and _JOINT.fullmatch(name) is None:
            pose[name] = _number(cell, name, delimiter) if _is_number(name) else cell
    for field, names in lists.items():
        if names:
            pose[field] = [_number(filled[name], name, delimiter) for name in names]
    return pose


def _unguarded(cell: str) -> str:
    return cell[1:] if cell.startswith("'") and cell[1:].startswith(_FORMULA) else cell


def _is_number(name: str) -> bool:
    """Return whether cells of a column are one number each."""
    name = _OTHER_NAMES.get(name, name)
    is_angle = name in POSE_FIELDS and name not in _LISTS and name.endswith("_deg")
    return is_angle or name in _AXES or _JOINT.fullmatch(name) is not None


def _parts(cell: str, delimiter: str | None) -> list[str]:
    """Return the numbers of a cell; those between which are spaces or semicolons may have decimal commas."""
    decimal = delimiter != "," and (cell.count(",") < 2 or re.search(r"[\s;]", cell) is not None)
    between = r"[\s;]+" if decimal else r"[\s,;]+"
    parts = (part.rstrip(",") for part in re.split(between, cell.strip("[]() ")))
    return [part for part in parts if part]


def _number(cell: str, name: str, delimiter: str | None) -> float:
    value = number_of(cell, comma=delimiter != ",")
    if not math.isfinite(value):
        raise RowError(f"{name} is not a number: {cell}")
    return value


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
        return "joint angles look like radians: all are below 7"
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
