"""`gridpose measured-poses import`: the file of an instrument to the measured poses of a session."""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from ... import ClientError, Json, find_or_make_session
from ..access import UploadAccess, exit_code
from ..console import error_console, print_error, print_json
from ..creation import AcceptImplausible
from ..record_files import Delimiter, FileFormat, FileRefused, Records, as_delimiter, read_records
from .instrument import parse_instrument, with_uncertainty
from .layout import CONVENTIONS, EULER, ColumnLayout, looks_like_joint, recognised, unused_columns
from .parser import RowError, parse_poses
from .reflectors import Reading, poses_of_reflectors, read_reflectors
from .repeats import refuse_restated

_MAX_LISTED = 20
_MAX_CHUNK_BYTES = 8 * 1024 * 1024
_MAX_CHUNK_POSES = 10_000
_TWO_PI = 2.0 * math.pi


class LengthUnit(enum.StrEnum):
    """Units of coordinates."""

    mm = "mm"
    m = "m"
    inch = "in"


class AngleUnit(enum.StrEnum):
    """Units of angles."""

    deg = "deg"
    rad = "rad"


_ADVICE = {
    "implausible_unit": "Coordinates were read in the unit of --length-unit: state the file's own, `--length-unit m` "
    "for metres. If the values are right, give --accept-implausible."
}
_IN_MM = {LengthUnit.mm: 1.0, LengthUnit.m: 1000.0, LengthUnit.inch: 25.4}
_IN_RAD = {AngleUnit.deg: math.radians(1.0), AngleUnit.rad: 1.0}


def import_poses(
    file: Annotated[
        Path, typer.Argument(help="CSV, JSON or YAML file of measured poses.", exists=True, dir_okay=False)
    ],
    service: UploadAccess,
    session: Annotated[
        str | None, typer.Option(help="Id or name of the session; a new name creates one, given --target.")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(help="Target of a new session: an id, or KIND:COLUMNSxROWS:PITCH_MM."),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            help="FIELD=COLUMN, repeatable: pose, cycle, joints (several columns, separated by commas), x, y, z, "
            "rx, ry, rz (or r1, r2, r3), qx, qy, qz, qw, reflector, and u_x ... for standard uncertainties. Columns "
            "are added with +: x=stage_x+probe_x.  [default: by their names, as pose_id, cycle, x_mm, roll_deg, j1_deg]"
        ),
    ] = None,
    reflectors: Annotated[
        Path | None,
        typer.Option(
            help="CSV of three or more reflectors on the flange: name, x_mm, y_mm, z_mm in its frame. Rows of one pose "
            "and cycle, each with a column `reflector`, become a pose.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    instrument_uncertainty: Annotated[
        str | None,
        typer.Option(
            help="Standard uncertainty of coordinates in mm, for readings without u_x ...: A or A+B, B per metre from "
            "the instrument."
        ),
    ] = None,
    rotation: Annotated[
        str | None,
        typer.Option(
            "--rotation-format",
            help="Convention of the angles: the order of the product, xyz for Rx Ry Rz, zyx for roll, pitch, yaw; "
            "vector; or none for positions alone. Needed for rx, ry, rz; columns roll_deg, pitch_deg, yaw_deg have it.",
        ),
    ] = None,
    lengths: Annotated[
        LengthUnit, typer.Option("--length-unit", help="Unit of coordinates.")
    ] = LengthUnit.mm,
    angles: Annotated[
        AngleUnit, typer.Option("--angle-unit", help="Unit of orientation angles.")
    ] = AngleUnit.deg,
    joint_angles: Annotated[
        AngleUnit, typer.Option("--joint-angle-unit", help="Unit of joint angles.")
    ] = AngleUnit.deg,
    file_format: FileFormat = None,
    delimiter: Delimiter = None,
    decimal: Annotated[
        str | None, typer.Option(help="Decimal sign of a CSV, . or ,  [default: by the numbers]")
    ] = None,
    prefix: Annotated[
        str, typer.Option("--pose-id-prefix", help="Prefix of the numbered pose IDs of poses without an ID.")
    ] = "r",
    skip_invalid: Annotated[
        bool, typer.Option("--skip-invalid", help="Send the valid poses and skip the others.")
    ] = False,
    accept_implausible: AcceptImplausible = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Read, check and show the first pose; send nothing.")
    ] = False,
) -> int:
    """Send poses measured by a laser tracker or another instrument to a session; repeating changes nothing.

    Ends with 0 when all are stored, 1 when some are refused (with their lines), 2 when the file cannot be read with
    these options.
    """
    console = error_console()
    try:
        layout = ColumnLayout(
            columns=_columns(column or ()),
            rotation=_rotation(rotation),
            length_mm=_IN_MM[lengths],
            angle_rad=_IN_RAD[angles],
            joint_deg=math.degrees(_IN_RAD[joint_angles]),
            decimal=decimal,
            prefix=prefix,
        )
        records = read_records(file, file_format, as_delimiter(delimiter))
        layout = recognised(records, layout)
        poses, errors = parse_poses(records, layout, by_reflector=reflectors is not None)
        _list_unused(console, unused_columns(records, layout, by_reflector=reflectors is not None), layout)
        if instrument_uncertainty is not None:
            instrument = parse_instrument(instrument_uncertainty)
            poses = [(place, with_uncertainty(pose, instrument)) for place, pose in poses]
        if reflectors is not None:
            known = read_reflectors(reflectors)
            poses, unfit = _fitted(console, records, poses, layout, known)
            errors += unfit
    except FileRefused as refused:
        print_error(console, str(refused), refused.advice)
        return 2
    _list_errors(console, errors)
    if errors and not skip_invalid:
        console.print("Nothing was sent. Correct the file, or skip these poses with --skip-invalid.")
        return 1
    invalid = {error.place for error in errors}
    poses = [(place, pose) for place, pose in poses if place not in invalid]
    if not poses:
        print_error(console, "The file holds no valid pose.")
        return 1
    if joint_angles == AngleUnit.deg:
        _warn_of_radians(console, [pose for _, pose in poses])
    if dry_run:
        print_json(poses[0][1])
        console.print(f"{len(poses)} poses; the first is shown, nothing was sent.")
        return 0
    if session is None:
        print_error(console, "No session was given.", "Give --session, its id or its name, or --dry-run.")
        return 2
    chunk: list[tuple[str, Json]] = []
    try:
        with service.client(console) as client:
            session_id, _ = find_or_make_session(client, session, target)
            if not accept_implausible:
                refuse_restated(client, session_id, session, [pose for _, pose in poses])
            for chunk in _chunks(poses):
                sent = [pose for _, pose in chunk]
                client.put_measured_poses(session_id, sent, accept_implausible=accept_implausible)
    except FileRefused as refused:
        print_error(console, str(refused), refused.advice)
        return 2
    except ClientError as error:
        print_error(console, f"{error.summary} ({error.code})")
        _list_errors(console, _located(error, chunk))
        if advice := _ADVICE.get(error.code, error.advice):
            console.print(escape(advice))
        return exit_code(error)
    pose_ids = {pose["pose_id"] for _, pose in poses}
    console.print(f"session {session_id}: {len(poses)} measured poses of {len(pose_ids)} pose IDs are stored")
    print(session_id)
    return 0


def _fitted(
    console: Console,
    records: Records,
    poses: Sequence[tuple[str, Json]],
    layout: ColumnLayout,
    reflectors: Mapping[str, list[float]],
) -> tuple[list[tuple[str, Json]], list[RowError]]:
    """Return the poses of several reflectors, and what is wrong with others; the largest residual is said."""
    column = layout.columns.get("reflector", "reflector")
    names = {record.place: str(record.fields.get(column, "")).strip() for record in records.entries}
    readings = [Reading(place, names[place], pose) for place, pose in poses]
    fitted, errors, (residual_mm, place) = poses_of_reflectors(readings, reflectors)
    console.print(
        f"{len(fitted)} poses of {len(readings)} readings; the largest residual is {residual_mm:.3f} mm, in {place}"
    )
    return fitted, errors


def _columns(options: Sequence[str]) -> dict[str, str]:
    columns = {}
    for text in options:
        name, equals, column = text.partition("=")
        if not equals or not name or not column:
            raise FileRefused(
                f"--column {text} has no column.", "Write FIELD=COLUMN, e.g. --column x=measurement_x."
            )
        columns[name.strip()] = column.strip()
    return columns


def _rotation(rotation: str | None) -> str | None:
    if rotation not in (None, "vector", "none") and not _is_sequence(str(rotation)):
        raise FileRefused(f"--rotation-format {rotation} is not a known convention.", f"{CONVENTIONS}.")
    return rotation


def _is_sequence(text: str) -> bool:
    """Return whether `text` is a sequence of three axes in which no axis follows itself."""
    return EULER.fullmatch(text) is not None and text[0] != text[1] != text[2]


def _warn_of_radians(console: Console, poses: Sequence[Json]) -> None:
    """Warn where joint angles in degrees seem to be radians."""
    angles = [a for pose in poses for a in pose.get("joint_angles_deg") or ()]
    if any(angles) and all(abs(a) < _TWO_PI for a in angles):
        console.print(
            "[yellow]All joint angles are below 6.3: if they are radians, give --joint-angle-unit rad.[/]"
        )


def _list_unused(console: Console, columns: Sequence[str], layout: ColumnLayout) -> None:
    """Name the columns that say nothing of the poses; those of joints that leave a choice, with the option."""
    if not columns:
        return
    console.print(f"[yellow]not used: {escape(', '.join(columns))}[/]")
    joints = [column for column in columns if looks_like_joint(column)]
    if joints and "joints" not in layout.columns:
        console.print(
            f"To read joint angles, give their columns: --column {escape('joints=' + ','.join(joints))}"
        )


def _list_errors(console: Console, errors: Sequence[RowError]) -> None:
    for error in errors[:_MAX_LISTED]:
        console.print(f"[red]{escape(error.place)}[/]: {escape(error.message)}")
    if len(errors) > _MAX_LISTED:
        console.print(f"and {len(errors) - _MAX_LISTED} more")


def _chunks(poses: Sequence[tuple[str, Json]]) -> Iterator[list[tuple[str, Json]]]:
    """Yield the poses in chunks of the size of one request."""
    chunk: list[tuple[str, Json]] = []
    size = 0
    for entry in poses:
        length = len(json.dumps(entry[1])) + 1
        if chunk and (size + length > _MAX_CHUNK_BYTES or len(chunk) >= _MAX_CHUNK_POSES):
            yield chunk
            chunk, size = [], 0
        chunk.append(entry)
        size += length
    yield chunk


def _located(error: ClientError, chunk: Sequence[tuple[str, Json]]) -> list[RowError]:
    """Return the service's messages on fields with their places in the file."""
    errors = []
    for name, message in error.fields:
        index, _, rest = name.partition(".")
        known = index.isdecimal() and int(index) < len(chunk)
        place = chunk[int(index)][0] if known else name
        errors.append(RowError(place, f"{rest} {message}" if known and rest else message))
    return errors
