"""`gridpose robots compensate`: commands of a table or a robot program, corrected by what a session identified."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

from ... import Json, find_robot, find_session
from ..access import UploadAccess
from ..console import OptionRefused, error_console
from ..output_files import print_bytes, write_file
from ..record_files import Delimiter, FileFormat, RecordFormat, as_delimiter, read_records
from ..rotations import Frame, parse_frame
from ..sessions.poses import identified_poses
from .programs import Controller, Program, controller_of, read_program

_FIELDS = ("pose_id", "position_mm", "roll_deg", "pitch_deg", "yaw_deg", "joint_angles_deg")
_TABLES = (".csv", ".json")
_FRAME = "x,y,z,roll,pitch,yaw"
_RESULTS = (
    "outcome",
    "uncorrected_error_mm",
    "uncorrected_error_deg",
    "expected_residual_mm",
    "expected_residual_deg",
)


def compensate(
    file: Annotated[
        Path,
        typer.Argument(
            help="Commanded poses: CSV, JSON or YAML, or a robot program.", exists=True, dir_okay=False
        ),
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
    controller: Annotated[
        Controller | None,
        typer.Option(help="Make of the controller whose program the file is.  [default: by its name]"),
    ] = None,
    base: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Frame of a program's points in the robot's base: {_FRAME}; again for a frame in this one.  "
            "[default: the base]"
        ),
    ] = None,
    tool: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Tool of a program's points on the flange: {_FRAME}; again for one on this.  [default: the flange]"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="File to write: .json, .csv, or of a program the program.  [default: on stdout]",
        ),
    ] = None,
) -> None:
    """Correct commanded poses by what a session identified of the robot, from file to file.

    A program of a controller (KUKA .dat and .src, ABB .mod, UR .script, FANUC .ls) is written back with the numbers of
    its points corrected, and nothing else changed.

    Columns of a CSV are those of `poses load`: pose_id, and joint angles (j1_deg, ...), or a whole pose of the flange
    in the robot's base (x_mm, y_mm, z_mm, roll_deg, pitch_deg, yaw_deg), or both. Commands that cannot be corrected
    are written as they were; `outcome` says why.
    """
    with service.connect() as client:
        make = controller or (controller_of(file) if file_format is None else None)
        frames = _frame(base, "--base"), _frame(tool, "--tool")
        program = None if make is None else read_program(file, make, *frames)
        form = "" if output is None else output.suffix.lower()
        if program is None and (base or tool):
            raise OptionRefused(
                "--base and --tool belong to a program's points; a table has those of the flange."
            )
        if program is None and output is not None and form not in _TABLES:
            raise OptionRefused(f"--output {output} is neither .csv nor .json.")
        body = {
            "session_id": find_session(client, session)["id"],
            "poses": _read(file, file_format, delimiter) if program is None else program.commands(),
            "source": source,
        }
        if confirming_session is not None:
            body["confirming_session_id"] = find_session(client, confirming_session)["id"]
        path = f"/v1/robots/{find_robot(client, robot)['id']}/compensate"
        found = client.create(f"{path}?curves=true" if curves else path, body)
        if program is None or form in _TABLES:
            _write(output, _text(found, as_json=form == ".json").encode())
        else:
            applied = {pose["pose_id"]: pose for pose in found["poses"] if pose["applied"]}
            _write(output, program.with_commands(applied))
        _show(found)
        if program is not None:
            _show_program(program, frames_given=bool(base or tool))


def _frame(texts: Sequence[str] | None, option: str) -> Frame:
    product = Frame()
    for text in texts or ():
        try:
            product @= parse_frame(text)
        except ValueError as error:
            raise OptionRefused(
                f"{option} {text} is no frame.", f"Give {_FRAME}, in mm and degrees."
            ) from error
    return product


def _write(output: Path | None, data: bytes) -> None:
    if output is None:
        print_bytes(data)
        return
    write_file(output, data)


def _read(file: Path, file_format: RecordFormat | None, delimiter: str | None) -> list[Json]:
    records = read_records(file, file_format, as_delimiter(delimiter))
    return [{name: pose[name] for name in _FIELDS if name in pose} for pose in identified_poses(records)]


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
    gain = found["validation"]["random_gain"]
    if gain["with_correction"] is not None and gain["nominal"] is not None:
        console.print(
            f"At held-out poses: {gain['with_correction']['position_rms_mm']:.3f} mm corrected, "
            f"{gain['nominal']['position_rms_mm']:.3f} mm as commanded."
        )
    for warning in found["warnings"]:
        console.print(f"[yellow]{escape(warning['detail'])}[/]")


def _show_program(program: Program, *, frames_given: bool) -> None:
    console = error_console()
    if program.has_cartesian_points and not frames_given:
        console.print(
            "Cartesian points are taken as those of the flange in the robot's base. Where the program has a tool or "
            "another base, give --tool and --base."
        )
    if len(program.frames) > 1:
        console.print(
            f"[yellow]Points are in several frames ({escape('; '.join(sorted(program.frames)))}), and all were taken "
            "in one: keep the corrections of the frame that --base and --tool are of.[/]"
        )
    if program.incomplete_lines:
        lines = ", ".join(map(str, program.incomplete_lines))
        console.print(
            f"[yellow]Points that are not whole, or that no move takes, were left as they are: line {lines}.[/]"
        )
