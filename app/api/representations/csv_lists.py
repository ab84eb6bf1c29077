"""Bulk lists sent as CSV (RFC 4180): the header has the fields' names of the JSON list, an empty cell is null.

A field that is a list of numbers is one cell of numbers with spaces, commas or semicolons between them, a matrix row
after row; `position_mm` may be the three columns `position_x_mm`, `position_y_mm` and `position_z_mm` instead.
"""

from __future__ import annotations

import csv
import io
import re
from typing import Any

from app.api.representations.analysis_tables import guarded
from app.errors import InvalidContent, TooLarge

MAX_ROWS = 20_000
_AXES = tuple(f"position_{axis}_mm" for axis in "xyz")
_COLUMNS = {"position_mm": 0, "joint_angles_deg": 0, "rotation": 3, "covariance": 6}
"""Fields that are lists of numbers, and of matrices how many columns they have."""
_NUMBERS = frozenset({"roll_deg", "pitch_deg", "yaw_deg", *_AXES})
_SEPARATORS = re.compile(r"[\s,;]+")


def read_csv_list(body: bytes) -> list[dict[str, Any]]:
    """Return the rows of a CSV as the objects of a JSON list; what is no number stays text, for the schema to refuse.

    Raises InvalidContent for what is no CSV with a header, TooLarge for too many rows.
    """
    try:
        text = body.decode("utf-8-sig")
        rows = [row for row in csv.reader(io.StringIO(text, newline=""), strict=True) if row]
    except (UnicodeDecodeError, csv.Error) as error:
        raise _invalid("is not valid CSV") from error
    if not rows:
        raise _invalid("has no header")
    header, *rows = rows
    names = [name.strip() for name in header]
    if len(set(names)) != len(names):
        raise _invalid("names a column twice")
    if 0 < len(set(_AXES) & set(names)) < len(_AXES) or (_AXES[0] in names and "position_mm" in names):
        raise _invalid("must have all of position_x_mm, position_y_mm, position_z_mm, or position_mm instead")
    if len(rows) > MAX_ROWS:
        raise TooLarge(f"The table has more than {MAX_ROWS} rows.", "Send fewer rows at a time.")
    return [_item(names, row, place) for place, row in enumerate(rows)]


def _item(names: list[str], row: list[str], place: int) -> dict[str, Any]:
    if len(row) != len(names):
        raise _invalid(f"has {len(row)} cells in row {place + 1}, and {len(names)} columns")
    cells = dict(zip(names, row, strict=True))
    item = {name: _value(name, cell.strip()) for name, cell in cells.items()}
    if _AXES[0] in item:
        position = [item.pop(axis) for axis in _AXES]
        item["position_mm"] = None if position == [None] * 3 else position
    return item


def _value(name: str, cell: str) -> Any:
    if not cell:
        return None
    if name == "cycle":
        return int(cell) if cell.isascii() and cell.isdecimal() and len(cell) < 20 else cell
    if name in _NUMBERS:
        return _number(cell)
    if name in _COLUMNS:
        numbers = [_number(part) for part in _SEPARATORS.split(cell.strip("[]() ")) if part]
        width = _COLUMNS[name]
        return [numbers[i : i + width] for i in range(0, len(numbers), width)] if width else numbers
    # An apostrophe that keeps a spreadsheet from taking the cell for a formula, as tables of analyses have it.
    return cell[1:] if cell.startswith("'") and guarded(cell[1:]) == cell else cell


def _number(cell: str) -> float | str:
    try:
        return float(cell) if cell.isascii() and "_" not in cell else cell
    except ValueError:
        return cell


def _invalid(message: str) -> InvalidContent:
    return InvalidContent(
        "The body is not a CSV table with a header.",
        "Send UTF-8 with commas and one header line, such as pose_id,position_x_mm,position_y_mm,position_z_mm.",
        code="invalid_csv",
        errors=[("body", message)],
    )
