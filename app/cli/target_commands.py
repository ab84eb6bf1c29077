"""Names, options and help of `gridpose target`; what they do stands in the modules of the same names."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer

target = typer.Typer(help="Print a target, and check a printed one.", no_args_is_help=True)


class Kind(enum.StrEnum):
    """Targets by what is printed."""

    chessboard = "chessboard"
    charuco = "charuco"
    circles = "circles"
    asymmetric_circles = "asymmetric_circles"
    aprilgrid = "aprilgrid"


class PaperSize(enum.StrEnum):
    """Papers by ISO 216."""

    a4 = "A4"
    a3 = "A3"
    a2 = "A2"
    a1 = "A1"
    a0 = "A0"


class FileFormat(enum.StrEnum):
    """Files a sheet is written as."""

    pdf = "pdf"
    svg = "svg"


TargetKind = Annotated[Kind | None, typer.Option(help="What is printed.")]
Columns = Annotated[
    int | None, typer.Option(help="Grid points along x: inner corners, dots, or tags.", min=2, max=500)
]
Rows = Annotated[int | None, typer.Option(help="Grid points along y.", min=2, max=500)]
Pitch = Annotated[float | None, typer.Option("--pitch-mm", help="Distance of neighbouring grid points.")]
Marker = Annotated[
    float | None, typer.Option("--marker-mm", help="Side of a marker or tag; diameter of a dot.")
]
Dictionary = Annotated[
    str | None, typer.Option(help="Of a ChArUco board's markers, by OpenCV's name, e.g. DICT_5X5_100.")
]
Legacy = Annotated[bool, typer.Option("--legacy-layout", help="ChArUco as before OpenCV 4.6.")]
TargetId = Annotated[
    str | None, typer.Option(help="Id of a target stored in a service, in place of its description.")
]
Url = Annotated[str, typer.Option(envvar="GRIDPOSE_URL", help="Where the service is, if one is asked.")]
Key = Annotated[str | None, typer.Option(envvar="GRIDPOSE_KEY", help="API key of scope read.")]
RetryFor = Annotated[float, typer.Option(help="Seconds to go on trying while the service is away.", min=0)]
_URL = "http://127.0.0.1:8000"


@target.command("pdf")
def target_pdf(
    kind: TargetKind = None,
    columns: Columns = None,
    rows: Rows = None,
    pitch_mm: Pitch = None,
    marker_mm: Marker = None,
    dictionary: Dictionary = None,
    legacy_layout: Legacy = False,
    target_id: TargetId = None,
    paper: Annotated[PaperSize, typer.Option(help="Upright or not, whichever fits better.")] = PaperSize.a4,
    marks: Annotated[
        bool, typer.Option("--marks", help="Mark squares of a chessboard, so that its parts can be told.")
    ] = False,
    origin_dot: Annotated[
        float, typer.Option(help="How many times wider the dot at the origin is, so that turns can be told.")
    ] = 1.0,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File, .pdf or .svg.  [default: by what is printed]")
    ] = None,
    file_format: Annotated[
        FileFormat | None, typer.Option("--format", help="Kind of file.  [default: by its name, else pdf]")
    ] = None,
    url: Url = _URL,
    key: Key = None,
    retry_for: RetryFor = 300.0,
) -> None:
    """Draw a target at true scale as PDF or SVG, with rulers along two sides and its own id.

    For example: gridpose target pdf --kind charuco --columns 9 --rows 6 --pitch-mm 25 --marker-mm 18
    --dictionary DICT_5X5_100 -o board.pdf
    """
    from app.cli.target_options import target_options
    from app.cli.target_pdf import Request, print_target

    request = Request(
        target=target_options(
            target_id=target_id,
            kind=kind,
            columns=columns,
            rows=rows,
            pitch_mm=pitch_mm,
            marker_mm=marker_mm,
            dictionary=dictionary,
            legacy_layout=legacy_layout,
            url=url,
            key=key,
            retry_for=retry_for,
        ),
        output=output,
        kind=file_format.value if file_format else None,
        paper=paper.value,
        origin_dot=origin_dot,
        marks=marks,
    )
    raise typer.Exit(print_target(request))


@target.command("check")
def target_check(
    photos: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Photographs of the print: one camera at one focus, ten or more, tilted to all sides and turned.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    kind: TargetKind = None,
    columns: Columns = None,
    rows: Rows = None,
    pitch_mm: Pitch = None,
    marker_mm: Marker = None,
    dictionary: Dictionary = None,
    legacy_layout: Legacy = False,
    target_id: TargetId = None,
    session: Annotated[
        str | None, typer.Option(help="Id or name of a service's session, in place of photographs.")
    ] = None,
    measured_mm: Annotated[
        list[str] | None,
        typer.Option(
            help="SIDE:STATED:READ, what a steel rule reads along a ruler of the sheet (or between two grid points of "
            "one row), e.g. x:250:249.2; for either side, as often as read."
        ),
    ] = None,
    measured_u_mm: Annotated[
        float, typer.Option("--measured-u-mm", help="Standard uncertainty of such a reading.", min=1e-6)
    ] = 0.1,
    limit_percent: Annotated[
        float, typer.Option(help="How far the print may be off, in percent of the grid's longer side.")
    ] = 0.1,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    url: Url = _URL,
    key: Key = None,
    retry_for: RetryFor = 300.0,
) -> None:
    """Tell from photographs how far a print is from what it states: stretch, squareness, flatness.

    Ends with 0 when all is within the limit, 1 when something is off or cannot be told, 2 when the options cannot be
    meant so.
    """
    from app.cli.target_check import Request, check_target
    from app.cli.target_options import target_options

    request = Request(
        photos=tuple(photos or ()),
        session=session,
        target=target_options(
            target_id=target_id,
            kind=kind,
            columns=columns,
            rows=rows,
            pitch_mm=pitch_mm,
            marker_mm=marker_mm,
            dictionary=dictionary,
            legacy_layout=legacy_layout,
            url=url,
            key=key,
            retry_for=retry_for,
        ),
        readings=tuple(measured_mm or ()),
        reading_u_mm=measured_u_mm,
        limit_percent=limit_percent,
        as_json=as_json,
    )
    raise typer.Exit(check_target(request))
