"""`gridpose poses load`: commanded poses of a file to a session."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Annotated

import typer

from ... import ClientError, Json, find_session
from ...pose_rows import (
    POSE_COLUMNS,
    POSE_FIELDS,
    RowError,
    check_decimal_signs,
    implausible_unit,
    in_unit,
    pose_of_cells,
)
from ..access import UploadAccess
from ..creation import AcceptImplausible
from ..record_files import Delimiter, FileFormat, FileRefused, Record, Records, as_delimiter, read_records


def load(
    file: Annotated[
        Path, typer.Argument(help="CSV, JSON or YAML file of poses.", exists=True, dir_okay=False)
    ],
    session: Annotated[str, typer.Option(help="Id or name of the session.")],
    service: UploadAccess,
    file_format: FileFormat = None,
    delimiter: Delimiter = None,
    accept_implausible: AcceptImplausible = False,
) -> None:
    """Store the commanded poses of a file in a session, all or none; a pose that is there is replaced whole.

    Columns of a CSV: pose_id, x_mm, y_mm, z_mm, roll_deg, pitch_deg, yaw_deg, j1_deg, j2_deg, ..., approach; or those
    that the API has, position_x_mm and joint_angles_deg in one cell. Only pose_id is needed, and an empty cell is a
    value that is not known. JSON and YAML have the fields of the API.
    """
    with service.connect(file) as client:
        records = read_records(file, file_format, as_delimiter(delimiter))
        poses = identified_poses(records, POSE_FIELDS)
        suspected = None if accept_implausible else implausible_unit(poses)
        if suspected is not None:
            raise FileRefused(
                f"In {file.name} the {suspected}. (implausible_unit)",
                "Lengths are mm and angles degrees. If they are right, give --accept-implausible.",
            )
        session_id = find_session(client, session)["id"]
        try:
            client.put_poses(session_id, poses, accept_implausible=accept_implausible)
        except ClientError as error:
            fields = [(_place(name, records), message) for name, message in error.fields]
            raise ClientError(error.code, error.summary, error.advice, error.status, fields) from error
        print(f"{session_id}: {len(poses)} commanded poses are stored")


def _place(field: str, records: Records) -> str:
    """Return the place in the file of a field that the service refuses."""
    index, _, name = field.partition(".")
    if not index.isdecimal() or int(index) >= len(records.entries):
        return field
    return f"{records.entries[int(index)].place} {name}".rstrip()


def fields_of_poses(records: Records) -> list[tuple[Record, Json]]:
    """Return each record with its fields by the names of the API; raises FileRefused."""
    if records.kind != "csv":
        return [(record, record.fields) for record in records.entries]
    try:
        check_decimal_signs(((one.place, one.fields) for one in records.entries), records.delimiter)
    except RowError as error:
        raise FileRefused(f"In the table, {error}.") from None
    return [(record, _of_cells(record, records.delimiter)) for record in records.entries]


def _of_cells(record: Record, delimiter: str | None) -> Json:
    try:
        return pose_of_cells(record.fields, delimiter)
    except RowError as error:
        raise FileRefused(f"In {record.place}: {error}.") from None


def identified_poses(records: Records, allowed: Collection[str] | None = None) -> list[Json]:
    """Return the poses of a file, each with its id; fields other than those `allowed` are refused.

    Raises FileRefused, of a file without poses, too.
    """
    poses = [_pose(record, given, allowed) for record, given in fields_of_poses(records)]
    if not poses:
        raise FileRefused("The file holds no poses.", f"Write one pose per line under {POSE_COLUMNS}.")
    return poses


def _pose(record: Record, given: Json, allowed: Collection[str] | None) -> Json:
    if unknown := sorted(set(given) - set(allowed or given)):
        advice = [f"{found}. " for name in unknown if (found := in_unit(name))]
        raise FileRefused(
            f"In {record.place} there is no such field of a pose: {', '.join(unknown)}.",
            f"{''.join(advice)}Columns of a CSV are {POSE_COLUMNS}; "
            f"fields of JSON and YAML are {', '.join(POSE_FIELDS)}.",
        )
    pose = {**given} if record.name is None else {"pose_id": record.name, **given}
    if isinstance(pose.get("pose_id"), bool):
        raise FileRefused(
            f"In {record.place} pose_id is read as {pose['pose_id']}, as YAML reads yes, no, on and off.",
            "Put it in quotes.",
        )
    if not pose.get("pose_id"):
        raise FileRefused(f"In {record.place} the pose has no pose_id.", "Give each pose an id of its own.")
    return pose
