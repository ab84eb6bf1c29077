"""`gridpose robots compensate`: commanded poses of a file, corrected by what a session identified of the robot."""

from __future__ import annotations

import csv
import io
import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from ... import Json, ServiceClient, find_robot, find_session
from ...pose_rows import POSE_COLUMNS, RowError, pose_of_cells
from ..access import UploadAccess
from ..console import OptionRefused, error_console
from ..record_files import Delimiter, FileFormat, FileRefused, RecordFormat, as_delimiter, read_records

_FIELDS = ("pose_id", "position_mm", "roll_deg", "pitch_deg", "yaw_deg", "joint_angles_deg")
_RESULTS = (
    "outcome",
    "uncorrected_error_mm",
    "uncorrected_error_deg",
    "expected_residual_mm",
    "expected_residual_deg",
)


def compensate(
    file: Annotated[
        Path, typer.Argument(help="CSV, JSON or YAML file of commanded poses.", exists=True, dir_okay=False)
    ],
    robot: Annotated[str, typer.Option(help="Id or name of the robot.")],
    session: Annotated[
        str, typer.Option(help="Id or name of the session that the robot is identified from.")
    ],
    service: UploadAccess,
    confirming_session: Annotated[
        str | None,
        typer.Option(
            help="A second session of the robot: joint curves count if they predict its poses, too."
        ),
    ] = None,
    curves: Annotated[
        bool, typer.Option("--curves", help="Take joint curves without a second session.")
    ] = False,
    source: Annotated[str, typer.Option(help="images, or measured_poses of another instrument.")] = "images",
    file_format: FileFormat = None,
    delimiter: Delimiter = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write, .json or .csv.  [default: CSV on stdout]"),
    ] = None,
) -> int:
    """Correct commanded poses by what a session identified of the robot, from file to file.

    Columns of a CSV are those of `poses load`: pose_id, and joint angles (j1_deg, ...), or a whole pose of the flange
    in the robot's base (x_mm, y_mm, z_mm, roll_deg, pitch_deg, yaw_deg), or both. Commands that cannot be corrected
    are written as they were; `outcome` says why.
    """

    def act(client: ServiceClient) -> None:
        if output is not None and output.suffix.lower() not in (".csv", ".json"):
            raise OptionRefused(f"--output {output} is neither .csv nor .json.")
        body = {
            "session_id": find_session(client, session)["id"],
            "poses": _read(file, file_format, delimiter),
            "source": source,
        }
        if confirming_session is not None:
            body["confirming_session_id"] = find_session(client, confirming_session)["id"]
        path = f"/v1/robots/{find_robot(client, robot)['id']}/compensate"
        found = client.create(f"{path}?curves=true" if curves else path, body)
        text = _text(found, as_json=output is not None and output.suffix.lower() == ".json")
        if output is None:
            sys.stdout.write(text)
        else:
            try:
                output.write_text(text, encoding="utf-8", newline="")
            except OSError as error:
                raise OptionRefused(f"{output} cannot be written: {error.strerror}.") from error
        _show(found)

    return service.run(act)


def _read(file: Path, file_format: RecordFormat | None, delimiter: str | None) -> list[Json]:
    records = read_records(file, file_format, as_delimiter(delimiter))
    poses = []
    for record in records.entries:
        try:
            given = (
                record.fields if records.kind != "csv" else pose_of_cells(record.fields, records.delimiter)
            )
        except RowError as error:
            raise FileRefused(f"In {record.place}: {error}.") from None
        pose = {**given} if record.name is None else {"pose_id": record.name, **given}
        if not pose.get("pose_id"):
            raise FileRefused(
                f"In {record.place} the pose has no pose_id.", "Give each pose an id of its own."
            )
        poses.append({name: pose[name] for name in _FIELDS if name in pose})
    if not poses:
        raise FileRefused("The file holds no poses.", f"Write one pose per line under {POSE_COLUMNS}.")
    return poses


def _text(found: Json, *, as_json: bool) -> str:
    if as_json:
        return json.dumps(found, indent=2, allow_nan=False) + "\n"
    joints = max((len(pose["joint_angles_deg"] or ()) for pose in found["poses"]), default=0)
    text = io.StringIO()
    rows = csv.writer(text)
    angles = [f"j{i}_deg" for i in range(1, joints + 1)]
    rows.writerow(["pose_id", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg", *angles, *_RESULTS])
    for pose in found["poses"]:
        position = pose["position_mm"] or (None,) * 3
        stated = pose["joint_angles_deg"] or (None,) * joints
        values = (*position, pose["roll_deg"], pose["pitch_deg"], pose["yaw_deg"], *stated)
        rows.writerow([pose["pose_id"], *map(_cell, values), *(_cell(pose[name]) for name in _RESULTS)])
    return text.getvalue()


def _cell(value: Any) -> Any:
    """Return a number with six decimals: a nanometre, and what moves a metre by as much."""
    return f"{value:.6f}" if isinstance(value, float) else value


def _show(found: Json) -> None:
    console = error_console()
    corrected = sum(pose["applied"] for pose in found["poses"])
    terms = " and ".join(["the chain", *found["terms"]]).replace("_", " ")
    console.print(f"{corrected} of {len(found['poses'])} commands corrected by {terms}.")
    random = found["validation"]["random"]
    if random["corrected"] is not None and random["nominal"] is not None:
        console.print(
            f"At held-out poses: {random['corrected']['position_rms_mm']:.3f} mm corrected, "
            f"{random['nominal']['position_rms_mm']:.3f} mm as commanded."
        )
    for warning in found["warnings"]:
        console.print(f"[yellow]{escape(warning['detail'])}[/]")
