"""`gridpose targets print`: a target as a file to print."""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from app.cli.options.access import ReadAccess
from app.cli.targets.options import TargetOptions, choose_target
from app.client import ClientError
from app.client.commands import error_console, print_error
from app.printing import Sheet, draw_sheet, to_pdf, to_svg
from core import GridposeError
from core.errors import InvalidArgument

_WRITERS = {"pdf": to_pdf, "svg": to_svg}


class PaperSize(enum.StrEnum):
    """Papers of ISO 216."""

    a4 = "A4"
    a3 = "A3"
    a2 = "A2"
    a1 = "A1"
    a0 = "A0"


class FileFormat(enum.StrEnum):
    """Formats of a sheet."""

    pdf = "pdf"
    svg = "svg"


def print_target(
    options: TargetOptions,
    service: ReadAccess,
    paper: Annotated[PaperSize, typer.Option(help="In the orientation that fits better.")] = PaperSize.a4,
    marks: Annotated[
        bool,
        typer.Option("--fiducials", help="Add fiducial dots to a chessboard, which identify a partial view."),
    ] = False,
    origin_dot: Annotated[
        float,
        typer.Option(
            "--origin-dot-ratio",
            help="Diameter of the dot at the origin relative to the others, to identify rotations.",
        ),
    ] = 1.0,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="File, .pdf or .svg.  [default: by the target]")
    ] = None,
    file_format: Annotated[
        FileFormat | None,
        typer.Option("--format", help="Format of the file.  [default: by its name, else pdf]"),
    ] = None,
) -> int:
    """Draw a target at true scale as PDF or SVG, with rulers along two sides and its own id.

    For example: gridpose targets print --kind charuco --columns 9 --rows 6 --pitch-mm 25 --marker-mm 18
    --dictionary DICT_5X5_100 -o board.pdf
    """
    console = error_console()
    try:
        suffix = _suffix(output, file_format)
        choice = choose_target(options, service)
        sheet = draw_sheet(choice.target, paper.value, origin_dot=origin_dot, marks=marks, name=choice.name)
    except (GridposeError, ClientError) as error:
        print_error(console, error.detail, error.advice)
        return 1 if isinstance(error, ClientError) else 2
    output = output or Path(_file_name(sheet, suffix))
    try:
        output.write_bytes(_WRITERS[suffix](sheet))
    except OSError as error:
        print_error(
            console,
            f"{output} cannot be written: {error.strerror}.",
            "Give a file in an existing, writable folder: --output FILE.",
        )
        return 1
    _show(console, sheet, output)
    return 0


def _suffix(output: Path | None, file_format: FileFormat | None) -> str:
    """Return pdf or svg, by the option or the file's name."""
    if output is None:
        return file_format or FileFormat.pdf
    suffix = output.suffix.lower().removeprefix(".")
    if file_format is not None:
        if suffix in _WRITERS and suffix != file_format:
            raise InvalidArgument(
                f"{output.name} is {suffix} by its name, and {file_format} by --format.",
                "Omit --format, or rename the file.",
            )
        return file_format
    if suffix not in _WRITERS:
        raise InvalidArgument(
            f"{output} has no known file format.",
            "Name it .pdf or .svg, or give --format.",
        )
    return suffix


def _file_name(sheet: Sheet, suffix: str) -> str:
    target = sheet.target
    size = f"{target.columns}x{target.rows}-{target.pitch_mm:g}mm"
    return f"{target.kind}-{size}-{sheet.paper.name}.{suffix}"


def _show(console: Console, sheet: Sheet, output: Path) -> None:
    console.print(f"{escape(str(output))}: {sheet.paper}")
    console.print(escape(sheet.title))
    console.print(
        "Print at 100 %, with fitting to the page off. Then lay a steel rule along the ruler below it "
        f"(0 to {sheet.along_x.length:g} mm, along x) and the one on its left (0 to {sheet.along_y.length:g} mm, "
        "along y)."
    )
    console.print(f"Once a service has the target, commands know it as --target sheet:{sheet.sheet_id}.")
    console.print(
        "`gridpose targets check` determines from photographs whether the print is square, true and flat."
    )
