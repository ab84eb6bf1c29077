"""What is known of an image besides its pixels: from its path, a sidecar file, and the tables of poses in the folder.

    P1/0001.png with P1/0001.json        {"cycle": 3, "joint_angles_deg": [0, -90, ...], "captured_at": "..."}
    P1/0001.png with P1/0001.csv         one row, with the columns of `gridpose poses load`
    poses.csv                            rows by image (column `file`) or by pose (column `pose_id`)

A sidecar takes precedence over a table, a table over the path.
"""

from __future__ import annotations

import csv
import errno
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from ...pose_rows import (
    RowError,
    check_decimal_signs,
    csv_rows,
    decoded,
    implausible_unit,
    in_unit,
    is_pose_column,
    pose_of_cells,
)

SIDECARS = (".json", ".csv")
TABLE = "poses.csv"
_COMMAND = ("position_mm", "roll_deg", "pitch_deg", "yaw_deg", "approach")
_NUMBERS = ("roll_deg", "pitch_deg", "yaw_deg")
_LISTS = {"position_mm": 3, "joint_angles_deg": None}
_KNOWN = {
    *_COMMAND,
    "pose_id",
    "cycle",
    "burst",
    "joint_angles_deg",
    "captured_at",
    "focus_group",
    "file",
    "filename",
}


class MetadataError(ValueError):
    """A sidecar or table cannot be used; the message names it and gives the reason."""


@dataclass(frozen=True, slots=True)
class ImageMetadata:
    """Metadata of one image; None where not known. `command` holds the fields of its commanded pose."""

    pose_id: str | None = None
    cycle: int | None = None
    joint_angles_deg: tuple[float, ...] | None = None
    captured_at: str | None = None
    focus_group: str | None = None
    command: dict[str, Any] = field(default_factory=dict)
    burst: int | None = None

    def over(self, other: ImageMetadata) -> ImageMetadata:
        """Return these values, completed by those of `other`."""

        def first(mine: Any, theirs: Any) -> Any:
            return theirs if mine is None else mine

        return ImageMetadata(
            first(self.pose_id, other.pose_id),
            first(self.cycle, other.cycle),
            first(self.joint_angles_deg, other.joint_angles_deg),
            first(self.captured_at, other.captured_at),
            first(self.focus_group, other.focus_group),
            {**other.command, **self.command},
            first(self.burst, other.burst),
        )


@dataclass(slots=True)
class PoseTable:
    """The complete rows of a table: metadata by image, commanded poses by pose, and what is wrong with other rows."""

    images: dict[str, ImageMetadata] = field(default_factory=dict)
    commands: dict[str, dict[str, Any]] = field(default_factory=dict)
    errors: list[str] = field(default_factory=list)

    def of(self, name: str) -> ImageMetadata | None:
        """Return the row of an image, by its path below the folder or by its bare name."""
        return self.images.get(name) or self.images.get(PurePosixPath(name).name)


def sidecar_of(path: Path) -> Path | None:
    """Return the sidecar file of an image: its name with another suffix, or with a second one; None for none."""
    for suffix in SIDECARS:
        for place in (path.with_suffix(suffix), path.with_name(path.name + suffix)):
            if _is_file(place):
                return place
    return None


def _is_file(path: Path) -> bool:
    """Return whether there is such a file; none has a name that the disk cannot hold. Raises OSError."""
    try:
        return path.is_file()
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            return False
        raise


def read_sidecar(path: Path) -> ImageMetadata:
    """Return what a sidecar file holds. Raises MetadataError, or OSError where it cannot be read."""
    text = decoded(path.read_bytes())
    try:
        if path.suffix.lower() == ".json":
            content = json.loads(text)
            if not isinstance(content, dict):
                raise RowError("it does not hold fields with their values")
            return _metadata(content)
        table = _rows(text, complete=False)
        if len(table) != 1:
            raise RowError(f"it has {len(table)} rows under its header, not one")
        return _metadata(pose_of_cells(*table[0][1:]))
    except (RowError, json.JSONDecodeError, RecursionError, csv.Error) as error:
        raise MetadataError(f"{path.name}: {error}") from None


def read_table(path: Path) -> PoseTable:
    """Return the complete rows of a table that may still be growing: its last line counts once it has ended.

    A row with `file` belongs to an image, a row without to the pose `pose_id`. Raises OSError.
    """
    table = PoseTable()
    try:
        rows = _rows(decoded(path.read_bytes()), complete=True)
    except (RowError, csv.Error) as error:
        table.errors.append(f"{path.name}: {error}")
        return table
    for line, cells, delimiter in rows:
        try:
            row = pose_of_cells(cells, delimiter)
            file = row.get("file") or row.get("filename")
            metadata = _metadata(row)
            if file:
                table.images[str(file).replace("\\", "/")] = metadata
            elif metadata.pose_id is None:
                raise RowError("has neither a file nor a pose_id")
            else:
                angles = metadata.joint_angles_deg
                joints = {} if angles is None else {"joint_angles_deg": list(angles)}
                table.commands[metadata.pose_id] = {**metadata.command, **joints}
        except RowError as error:
            table.errors.append(f"{path.name}, line {line}: {error}")
    rows_of_images = (
        {"joint_angles_deg": row.joint_angles_deg, **row.command} for row in table.images.values()
    )
    if suspected := implausible_unit([*table.commands.values(), *rows_of_images]):
        table.errors.append(
            f"{path.name}: {suspected}; they are taken as they are, correct the table if they are not"
        )
    return table


def _rows(text: str, *, complete: bool) -> list[tuple[int, dict[str, str], str]]:
    """Return line, cells by column, and delimiter of each row."""
    if complete and not text.endswith(("\n", "\r")):
        text = text[: max(text.rfind("\n"), text.rfind("\r")) + 1]
    reader, delimiter = csv_rows(text)
    names = [name.strip() for name in next(reader, [])]
    if unknown := [name for name in names if name and not _is_column(name)]:
        advice = [f". {found}" for name in unknown if (found := in_unit(name))]
        raise RowError(f"there is no such column of a pose: {', '.join(unknown)}{''.join(advice)}")
    rows: list[tuple[int, dict[str, str], str]] = []
    for cells in reader:
        if any(cell.strip() for cell in cells):
            if len(cells) != len(names):
                raise RowError(f"line {reader.line_num} has {len(cells)} cells, the header {len(names)}")
            row = {name: cell.strip() for name, cell in zip(names, cells, strict=True)}
            rows.append((reader.line_num, row, delimiter))
    check_decimal_signs(((f"line {line}", row) for line, row, _ in rows), delimiter)
    return rows


def _is_column(name: str) -> bool:
    return is_pose_column(name) or name in _KNOWN


def _metadata(fields: Mapping[str, Any]) -> ImageMetadata:
    if unknown := sorted(set(fields) - _KNOWN):
        raise RowError(f"there is no such field of an image: {', '.join(unknown)}")
    fields = {name: value for name, value in fields.items() if value is not None}
    numbers = {name: _number(name, fields[name]) for name in _NUMBERS if name in fields}
    lists = {name: _list(name, fields[name], length) for name, length in _LISTS.items() if name in fields}
    angles = lists.pop("joint_angles_deg", None)
    command: dict[str, Any] = {**lists, **numbers}
    if "approach" in fields:
        command["approach"] = str(fields["approach"])
    return ImageMetadata(
        pose_id=_text(fields, "pose_id"),
        cycle=_counted(fields, "cycle"),
        joint_angles_deg=None if angles is None else tuple(angles),
        captured_at=_text(fields, "captured_at"),
        focus_group=_text(fields, "focus_group"),
        command=command,
        burst=_counted(fields, "burst"),
    )


def _counted(fields: Mapping[str, Any], name: str) -> int | None:
    """Return a whole number from 1, None where it is not stated."""
    value = fields.get(name)
    if value is None:
        return None
    whole = _number(name, float(value) if isinstance(value, str) and value.isdecimal() else value)
    if whole != int(whole) or whole < 1:
        raise RowError(f"{name} {value} is not a whole number from 1")
    return int(whole)


def _text(fields: Mapping[str, Any], name: str) -> str | None:
    return str(fields[name]) if fields.get(name) not in (None, "") else None


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise RowError(f"{name} is not a number: {value}")
    return float(value)


def _list(name: str, value: Any, length: int | None) -> list[float]:
    if not isinstance(value, list) or not value or (length is not None and len(value) != length):
        raise RowError(f"{name} is not a list of {length or 'the joints’'} numbers: {value}")
    return [_number(name, one) for one in value]
