"""`gridpose poses load`: commanded poses of a file to a session."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any

import typer

from app.cli.client_options import UploadAccess
from app.cli.record_files import FileRefused, Record, RecordFormat, Records, as_delimiter, read_records
from app.client import ClientError, Json, ServiceClient, find_session

_FIELDS = ("pose_id", "position_mm", "roll_deg", "pitch_deg", "yaw_deg", "joint_angles_deg", "approach")
_AXES = ("x_mm", "y_mm", "z_mm")
_JOINT = re.compile(r"j([1-9][0-9]?)_deg")
_COLUMNS = "pose_id, x_mm, y_mm, z_mm, roll_deg, pitch_deg, yaw_deg, j1_deg, j2_deg, ..., approach"


def load(
    file: Annotated[
        Path, typer.Argument(help="CSV, JSON or YAML file of poses.", exists=True, dir_okay=False)
    ],
    session: Annotated[str, typer.Option(help="Id or name of the session.")],
    service: UploadAccess,
    file_format: Annotated[
        RecordFormat | None, typer.Option("--format", help="Format of the file.  [default: by its name]")
    ] = None,
    delimiter: Annotated[
        str | None, typer.Option(help="Of a CSV's columns, or tab.  [default: by the first line]")
    ] = None,
) -> int:
    """Store the commanded poses of a file in a session, all or none; a pose that is there is replaced whole.

    Columns of a CSV: pose_id, x_mm, y_mm, z_mm, roll_deg, pitch_deg, yaw_deg, j1_deg, j2_deg, ..., approach. Only
    pose_id is needed, and an empty cell is a value that is not known. JSON and YAML have the fields of the API.
    """

    def act(client: ServiceClient) -> None:
        records = read_records(file, file_format, as_delimiter(delimiter))
        poses = [_pose(record, records) for record in records.entries]
        if not poses:
            raise FileRefused("The file holds no poses.", f"Write one pose per line under {_COLUMNS}.")
        session_id = find_session(client, session)["id"]
        try:
            client.put_poses(session_id, poses)
        except ClientError as error:
            fields = [(_place(name, records), message) for name, message in error.fields]
            raise ClientError(error.code, error.summary, error.advice, error.status, fields) from error
        print(f"{session_id}: {len(poses)} commanded poses are stored")

    return service.run(act)


def _place(field: str, records: Records) -> str:
    """Return the place in the file of a field that the service refuses."""
    index, _, name = field.partition(".")
    if not index.isdecimal() or int(index) >= len(records.entries):
        return field
    return f"{records.entries[int(index)].place} {name}".rstrip()


def _pose(record: Record, records: Records) -> Json:
    given = record.fields if records.kind != "csv" else _of_cells(record, records.delimiter)
    unknown = sorted(set(given) - set(_FIELDS))
    if unknown:
        raise FileRefused(
            f"In {record.place} there is no such field of a pose: {', '.join(unknown)}.",
            f"Columns of a CSV are {_COLUMNS}; fields of JSON and YAML are {', '.join(_FIELDS)}.",
        )
    pose = {**given} if record.name is None else {"pose_id": record.name, **given}
    if not pose.get("pose_id"):
        raise FileRefused(f"In {record.place} the pose has no pose_id.", "Give each pose an id of its own.")
    return pose


def _of_cells(record: Record, delimiter: str | None) -> Json:
    """Return the fields of a pose from the cells of a row; None for an empty one."""
    cells = {name: cell for name, cell in record.fields.items() if cell}
    joints = sorted((int(match[1]), name) for name in cells if (match := _JOINT.fullmatch(name)))
    lists = {
        "position_mm": [name for name in _AXES if name in cells],
        "joint_angles_deg": [n for _, n in joints],
    }
    if [number for number, _ in joints] != list(range(1, len(joints) + 1)):
        raise FileRefused(f"In {record.place} a joint angle is missing.", "Fill j1_deg to the last, or none.")
    if len(lists["position_mm"]) not in (0, len(_AXES)):
        raise FileRefused(f"In {record.place} a coordinate is missing.", "Fill x_mm, y_mm and z_mm, or none.")
    pose: dict[str, Any] = {}
    for name, cell in cells.items():
        if name not in _AXES and _JOINT.fullmatch(name) is None:
            is_number = name in _FIELDS and name.endswith("_deg")
            pose[name] = _number(cell, record, name, delimiter) if is_number else cell
    for field, names in lists.items():
        if names:
            pose[field] = [_number(cells[name], record, name, delimiter) for name in names]
    return pose


def _number(cell: str, record: Record, name: str, delimiter: str | None) -> float:
    """Return a number, also with a decimal comma where commas do not separate columns."""
    try:
        value = float(cell if delimiter == "," else cell.replace(",", "."))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileRefused(f"In {record.place}, {name} is not a number: {cell}.")
    return value
