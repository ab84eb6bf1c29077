"""`gridpose import`: an instrument's file into the measured poses of a session, through the service."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import stamina
from rich.console import Console
from rich.markup import escape

from app.agent import ClientError, Json, ServiceClient
from app.cli.import_readings import EULER, Layout, Problem, read_readings
from app.cli.import_records import FileRefused, read_records
from app.cli.upload import find_or_make_session

SHOWN = 20
CHUNK_BYTES = 8 * 1024 * 1024
LENGTHS = {"mm": 1.0, "m": 1000.0, "in": 25.4}
ANGLES = {"deg": math.radians(1.0), "rad": 1.0}
_TWO_PI = 2.0 * math.pi


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The options of `gridpose import`."""

    file: Path
    session: str | None
    url: str
    key: str | None
    target: str | None
    kind: str | None
    columns: Sequence[str]
    rotation: str | None
    lengths: str
    angles: str
    joint_angles: str
    delimiter: str | None
    decimal: str | None
    prefix: str
    skip: bool
    dry_run: bool
    retry_for_s: float


def import_poses(request: Request) -> int:
    """Read the file, send what it holds, and return the exit code; nothing is sent where a reading is unsound."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    stamina.instrumentation.set_on_retry_hooks([])
    try:
        layout = _layout(request)
        records = read_records(request.file, request.kind, _delimiter(request.delimiter))
        readings, problems = read_readings(records, layout)
    except FileRefused as refused:
        console.print(f"[red]{escape(str(refused))}[/]")
        if refused.advice:
            console.print(escape(refused.advice))
        return 2
    _show(console, problems, "left out" if request.skip else "wrong")
    unsound = {problem.place for problem in problems}
    if problems and not request.skip:
        console.print("Nothing was sent. Correct the file, or leave these out with --skip-invalid.")
        return 1
    readings = [(place, reading) for place, reading in readings if place not in unsound]
    if not readings:
        console.print("[red]No reading is left to send.[/]")
        return 1
    _hint(console, request, [reading for _, reading in readings])
    if request.dry_run:
        print(json.dumps(readings[0][1], indent=2, allow_nan=False))
        console.print(f"{len(readings)} readings; the first is shown, nothing was sent.")
        return 0
    if request.session is None:
        console.print("[red]No session was named.[/] Give --session, its id or its name, or --dry-run.")
        return 2
    return _send(console, request, request.session, readings)


def _layout(request: Request) -> Layout:
    columns = {}
    for text in request.columns:
        name, equals, column = text.partition("=")
        if not equals or not name or not column:
            raise FileRefused(
                f"--column {text} names no column.", "Write FIELD=COLUMN, e.g. --column x=measurement_x."
            )
        columns[name.strip()] = column.strip()
    rotation = request.rotation
    if rotation is not None and rotation != "vector" and not _is_sequence(rotation):
        raise FileRefused(
            f"--rotation {rotation} is no convention known here.",
            "Give the order of the product, such as xyz for Rx Ry Rz or zyx for Rz Ry Rx (roll, pitch, yaw), "
            "or vector.",
        )
    return Layout(
        columns=columns,
        rotation=rotation,
        length_mm=LENGTHS[request.lengths],
        angle_rad=ANGLES[request.angles],
        joint_deg=math.degrees(ANGLES[request.joint_angles]),
        decimal=request.decimal,
        prefix=request.prefix,
    )


def _is_sequence(text: str) -> bool:
    """Tell whether `text` names three turns none of which is about the same axis as the one before."""
    return EULER.fullmatch(text) is not None and text[0] != text[1] != text[2]


def _delimiter(text: str | None) -> str | None:
    if text in (None, "tab", "\\t"):
        return "\t" if text else None
    if text is not None and len(text) != 1:
        raise FileRefused("--delimiter is one character, or tab.")
    return text


def _hint(console: Console, request: Request, readings: Sequence[Json]) -> None:
    """Ask about what looks like the wrong unit."""
    angles = [a for reading in readings for a in reading.get("joint_angles_deg") or ()]
    if request.joint_angles == "deg" and angles and all(abs(a) < _TWO_PI for a in angles) and any(angles):
        console.print(
            "[yellow]All joint angles are below 6.3: if they are radians, say --joint-angles rad.[/]"
        )


def _show(console: Console, problems: Sequence[Problem], what: str) -> None:
    for problem in problems[:SHOWN]:
        console.print(f"[red]{escape(problem.place)}[/]: {escape(problem.message)}")
    if len(problems) > SHOWN:
        console.print(f"and {len(problems) - SHOWN} more are {what}")


def _send(console: Console, request: Request, session: str, readings: Sequence[tuple[str, Json]]) -> int:
    chunk: list[tuple[str, Json]] = []
    try:
        client = ServiceClient(
            request.url,
            request.key,
            retry_for_s=request.retry_for_s,
            on_retry=lambda reason: console.print(f"[yellow]trying again: {escape(reason)}[/]"),
        )
        with client:
            session_id, _ = find_or_make_session(client, session, request.target)
            for chunk in _chunks(readings):
                client.put_measured_poses(session_id, [reading for _, reading in chunk])
    except ClientError as error:
        console.print(f"[red]{escape(error.summary)}[/] ({error.code})")
        _show(console, _places(error, chunk), "wrong")
        if error.advice:
            console.print(escape(error.advice))
        return 1
    poses = len({reading["pose_id"] for _, reading in readings})
    console.print(f"session {session_id}: {len(readings)} readings of {poses} poses are stored")
    print(session_id)
    return 0


def _chunks(readings: Sequence[tuple[str, Json]]) -> Iterator[list[tuple[str, Json]]]:
    """Yield the readings in parts that one request may carry."""
    part: list[tuple[str, Json]] = []
    size = 0
    for entry in readings:
        length = len(json.dumps(entry[1])) + 1
        if part and size + length > CHUNK_BYTES:
            yield part
            part, size = [], 0
        part.append(entry)
        size += length
    yield part


def _places(error: ClientError, chunk: Sequence[tuple[str, Json]]) -> list[Problem]:
    """Return the service's remarks on fields with the lines that they are about."""
    problems = []
    for name, message in error.fields:
        index, _, rest = name.partition(".")
        known = index.isdecimal() and int(index) < len(chunk)
        place = chunk[int(index)][0] if known else name
        problems.append(Problem(place, f"{rest} {message}" if known and rest else message))
    return problems
