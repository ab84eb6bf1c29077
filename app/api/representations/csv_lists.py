"""Bulk lists sent as CSV (RFC 4180): the header has the fields' names of the JSON list, an empty cell is null.

A field that is a list of numbers is one cell of numbers with spaces, commas or semicolons between them, a matrix row
after row. `position_mm` may be the three columns `position_x_mm`, `position_y_mm`, `position_z_mm`, or `x_mm`, `y_mm`,
`z_mm`; `joint_angles_deg` the columns `j1_deg`, `j2_deg`, ... Columns may be separated by semicolons or tabs, too;
numbers may then have decimal commas, as spreadsheets write them. A first line `sep=;` and UTF-16 with its mark are
read, too. A column `id`, which lists of the service have, is not read.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from typing import Any

from app.errors import InvalidContent, TooLarge
from app.markup import guarded

MAX_ROWS = 20_000
DELIMITERS = ",;\t"
_STATED_DELIMITER = re.compile(r'"?sep=([,;\t])"?[,;\t]*(?:\r\n|\r|\n)', re.IGNORECASE)
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_AXES = tuple(f"position_{axis}_mm" for axis in "xyz")
_OTHER_NAMES = {f"{axis}_mm": f"position_{axis}_mm" for axis in "xyz"}
_JOINT = re.compile(r"j([1-9][0-9]?)_deg")
_COLUMNS = {"position_mm": 0, "joint_angles_deg": 0, "rotation": 3, "covariance": 6}
"""Fields that are lists of numbers, and of matrices how many columns they have."""
_NUMBERS = frozenset({"roll_deg", "pitch_deg", "yaw_deg", *_AXES})
_MADE_HERE = "id"


def read_csv_list(body: bytes) -> list[dict[str, Any]]:
    """Return the rows of a CSV as the objects of a JSON list; what is no number stays text, for the schema to refuse.

    Raises InvalidContent for what is no CSV with a header, TooLarge for too many rows.
    """
    try:
        text = body.decode("utf-16" if body.startswith(_UTF16) else "utf-8-sig")
        stated = _STATED_DELIMITER.match(text)
        delimiter = stated[1] if stated else max(DELIMITERS, key=text.partition("\n")[0].count)
        text = text[stated.end() :] if stated else text
        lines = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=delimiter)
        rows = [row for row in lines if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise _invalid("is not valid CSV") from error
    if not rows:
        raise _invalid("has no header")
    header, *rows = rows
    names = [_OTHER_NAMES.get(name.strip(), name.strip()) for name in header]
    _check_columns(names)
    if len(rows) > MAX_ROWS:
        raise TooLarge(f"The table has more than {MAX_ROWS} rows.", "Send fewer rows at a time.")
    if delimiter != ",":
        _check_decimal_signs(names, rows, delimiter)
    return [_item(names, row, place, delimiter) for place, row in enumerate(rows)]


def _check_columns(names: list[str]) -> None:
    if len(set(names)) != len(names):
        raise _invalid("names a column twice")
    if 0 < len(set(_AXES) & set(names)) < len(_AXES) or (_AXES[0] in names and "position_mm" in names):
        raise _invalid("must have all of position_x_mm, position_y_mm, position_z_mm, or position_mm instead")
    joints = {name for name in names if _JOINT.fullmatch(name)}
    if joints != {f"j{number}_deg" for number in range(1, len(joints) + 1)}:
        raise _invalid("must have the columns of all joints, j1_deg to the last")
    if joints and "joint_angles_deg" in names:
        raise _invalid("must have either j1_deg, j2_deg, ... or joint_angles_deg")


def _check_decimal_signs(names: list[str], rows: list[list[str]], delimiter: str) -> None:
    """Refuse a table in which some numbers have a comma and some a point: one may be between thousands."""
    first: dict[str, str] = {}
    for place, row in enumerate(rows, 1):
        for name, cell in zip(names, row, strict=False):
            one = name in _NUMBERS or _is_joint(name)
            for text in [cell] if one else _parts(cell, delimiter) if name in _COLUMNS else ():
                for sign in {",", "."}.intersection(text):
                    first.setdefault(sign, f"{name} is {text.strip()} in row {place}")
    if len(first) > 1:
        found = " and ".join(dict.fromkeys(first[sign] for sign in ",."))
        raise _invalid(f"must have one decimal sign, and none between thousands: {found}")


def _item(names: list[str], row: list[str], place: int, delimiter: str) -> dict[str, Any]:
    if len(row) != len(names):
        raise _invalid(f"has {len(row)} cells in row {place + 1}, and {len(names)} columns")
    cells = dict(zip(names, row, strict=True))
    item = {name: _value(name, cell.strip(), delimiter) for name, cell in cells.items() if name != _MADE_HERE}
    if _AXES[0] in item:
        position = [item.pop(axis) for axis in _AXES]
        item["position_mm"] = None if position == [None] * 3 else position
    joints = [item.pop(f"j{number}_deg") for number in range(1, 1 + sum(map(_is_joint, names)))]
    while joints and joints[-1] is None:
        joints.pop()
    return {**item, "joint_angles_deg": joints} if joints else item


def _is_joint(name: str) -> bool:
    return _JOINT.fullmatch(name) is not None


def _value(name: str, cell: str, delimiter: str) -> Any:
    if not cell:
        return None
    if (
        cell.startswith("'") and guarded(cell[1:]) == cell
    ):  # an apostrophe against formulas, as in our own tables
        cell = cell[1:]
    if name == "cycle":
        return int(cell) if cell.isascii() and cell.isdecimal() and len(cell) < 20 else cell
    if name in _NUMBERS or _is_joint(name):
        return _number(cell, delimiter)
    if name in _COLUMNS:
        numbers = [_number(part, delimiter) for part in _parts(cell, delimiter)]
        width = _COLUMNS[name]
        return [numbers[i : i + width] for i in range(0, len(numbers), width)] if width else numbers
    return cell


def _parts(cell: str, delimiter: str) -> list[str]:
    """Return the numbers of a cell; those between which are spaces or semicolons may have decimal commas."""
    cell = cell.strip("[]() ")
    decimal = delimiter != "," and (cell.count(",") < 2 or re.search(r"[\s;]", cell) is not None)
    between = r"[\s;]+" if decimal else r"[\s,;]+"
    parts = (part.rstrip(",") for part in re.split(between, cell))
    return [part for part in parts if part]


def _number(cell: str, delimiter: str) -> float | str:
    text = cell if delimiter == "," else cell.replace(",", ".")
    try:
        return float(text) if text.isascii() and "_" not in text else cell
    except ValueError:
        return cell


def _invalid(message: str) -> InvalidContent:
    return InvalidContent(
        "The body is not a CSV table with a header.",
        "Send UTF-8 with one header line, such as pose_id,x_mm,y_mm,z_mm,roll_deg,pitch_deg,yaw_deg,j1_deg,j2_deg.",
        code="invalid_csv",
        errors=[("body", message)],
    )
