"""`gridpose qualify`: known lengths against what a session measured of them, stored as a record; and their list."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from ... import Json, find_session
from ..access import ReadAccess, UploadAccess
from ..console import OptionRefused, output_console, print_list
from ..record_files import read_records

_POSES = ("from_pose_id", "to_pose_id")
_NUMBERS = ("length_mm", "standard_uncertainty_mm")
_COLUMNS = ("id", "made", "due", "decision", "worst mm", "scale ppm", "robot", "camera", "session")
_CHARTED = (
    ("worst_error_mm", "The size of the worst error"),
    ("scale_ppm", "The scale"),
    ("probing_scatter_mm", "The scatter"),
)


def qualify(
    session: Annotated[str, typer.Argument(help="Id or name of the session that visited the poses.")],
    lengths: Annotated[
        Path,
        typer.Argument(
            help="CSV, JSON or YAML with from_pose_id, to_pose_id, length_mm, standard_uncertainty_mm.",
            exists=True,
            dir_okay=False,
        ),
    ],
    service: UploadAccess,
    maximum_error_mm: Annotated[
        float | None, typer.Option(help="Limit on every length's error, to be decided on.", min=0.0)
    ] = None,
    source: Annotated[str, typer.Option(help="images, or measured_poses of another instrument.")] = "images",
    valid_days: Annotated[
        int, typer.Option(help="After how many days the next qualification is due.", min=1, max=36500)
    ] = 365,
    camera: Annotated[
        str | None, typer.Option(help="Your own name of the camera, such as its serial number.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="The record as a file, .json, too; an existing one is kept."),
    ] = None,
) -> int:
    """Compare known lengths between poses of a session with what it measured of them, and store the result.

    Analyses and reports cite the latest record of the session's robot, or else of the installation. Lengths come from a
    stage, from gauge blocks, or from the robot measured by a standard. Exit code 3: a length is beyond the limit, or
    the limit cannot be decided on.
    """
    with service.connect() as client:
        body = {
            "lengths": _read(lengths),
            "maximum_permissible_error_mm": maximum_error_mm,
            "source": source,
            "valid_days": valid_days,
            "camera_name": camera,
        }
        if output is not None and output.exists():
            raise OptionRefused(f"{output} exists.", "A record is not replaced; give another name.")
        session_id = find_session(client, session)["id"]
        record = client.create(f"/v1/sessions/{session_id}/qualifications", body)
        if output is not None:
            _write(output, record)
        _show(record["analysis"])
        _show_control(record)
    return 3 if record["decision"] in ("fail", "inconclusive") else 0


def show_list(
    service: ReadAccess,
    robot: Annotated[
        str | None, typer.Option(help="Id of a robot: its qualifications alone.  [default: all]")
    ] = None,
) -> None:
    """List qualifications by known lengths, those of deleted sessions too."""
    with service.connect() as client:
        query = {"robot_id": robot} if robot is not None else {}
        rows = [
            (
                *(one["id"], one["made_at"][:10], one["due_at"][:10], one["decision"] or "no limit"),
                *(f"{one['worst_error_mm']:+.4f}", f"{one['scale_ppm']:+.0f}"),
                *(one["robot_id"] or "", one["camera_name"] or "", one["session_name"]),
            )
            for one in client.items("/v1/qualifications", **query)
        ]
        print_list(_COLUMNS, rows, "There are no qualifications yet; `gridpose qualify --help` says how.")


def _read(path: Path) -> list[dict[str, Any]]:
    found = []
    for record in read_records(path, None, None).entries:
        missing = [name for name in (*_POSES, *_NUMBERS) if record.fields.get(name) in (None, "")]
        if missing:
            raise OptionRefused(
                f"{path.name}, {record.place}: {', '.join(missing)} missing.",
                "Give from_pose_id, to_pose_id, length_mm and standard_uncertainty_mm of every length.",
            )
        try:
            numbers = {name: float(record.fields[name]) for name in _NUMBERS}
        except (TypeError, ValueError):
            raise OptionRefused(f"{path.name}, {record.place}: a length is not a number.") from None
        found.append({name: str(record.fields[name]) for name in _POSES} | numbers)
    return found


def _write(path: Path, record: Json) -> None:
    try:
        with path.open("x", encoding="utf-8") as file:
            json.dump(record, file, indent=2, allow_nan=False)
            file.write("\n")
    except FileExistsError:
        raise OptionRefused(f"{path} exists.", "A record is not replaced; give another name.") from None
    except OSError as error:
        raise OptionRefused(f"{path} cannot be written: {error.strerror}.") from error


def _show(found: Json) -> None:
    console = output_console()
    table = Table(title="Length errors, mm", title_justify="left")
    for column in ("from", "to", "calibrated", "measured", "error", "95 % interval"):
        table.add_column(column)
    for one in found["lengths"]:
        low, high = one["interval_mm"]
        table.add_row(
            escape(one["from_pose_id"]),
            escape(one["to_pose_id"]),
            f"{one['length_mm']:.4f}",
            f"{one['measured_mm']:.4f}",
            f"{one['error_mm']:+.4f}",
            f"{low:+.4f} to {high:+.4f}",
        )
    console.print(table)
    scale, u = found["scale_ppm"], found["scale_standard_uncertainty_ppm"]
    console.print(f"Lengths are measured {scale:+.0f} ppm too long, standard uncertainty {u:.0f} ppm.")
    if found["probing_scatter_mm"] is not None:
        console.print(
            f"Largest distance of a visit from its pose's mean: {found['probing_scatter_mm']:.4f} mm."
        )
    if found["decision"] is not None:
        limit = found["maximum_permissible_error_mm"]
        console.print(f"Limit of {limit:g} mm: {found['decision']}.")


def _show_control(record: Json) -> None:
    """Say until when the record holds, and which figures are not what earlier records let expect."""
    console = output_console()
    for name, words in _CHARTED:
        control = record[f"control_{name}"]
        if control is not None and not control["in_control"]:
            console.print(
                f"{words} ({name} {record[name]:.4g}) is outside the control limits {control['low']:.4g} to "
                f"{control['high']:.4g} of {control['records']} earlier qualifications: find out what changed."
            )
    console.print(f"Stored as {record['id']}; the next qualification is due on {record['due_at'][:10]}.")
