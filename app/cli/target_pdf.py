"""`gridpose target pdf`: a target as a file to print."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import stamina
from rich.console import Console
from rich.markup import escape

from app.agent import ClientError
from app.cli.target_options import TargetOptions, chosen_target
from app.printing.documents import to_pdf, to_svg
from app.printing.sheet import Sheet, draw_sheet
from core import GridposeError
from core.errors import InvalidArgument

WRITERS = {"pdf": to_pdf, "svg": to_svg}


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The options of `gridpose target pdf`."""

    target: TargetOptions
    output: Path | None
    kind: str | None
    paper: str
    origin_dot: float
    marks: bool


def print_target(request: Request) -> int:
    """Draw the sheet, write the file, and return the exit code."""
    console = Console(stderr=True, highlight=False, soft_wrap=True)
    stamina.instrumentation.set_on_retry_hooks([])
    try:
        kind = _kind(request)
        named = chosen_target(request.target)
        sheet = draw_sheet(
            named.target,
            request.paper,
            origin_dot=request.origin_dot,
            marks=request.marks,
            name=named.name,
        )
    except (GridposeError, ClientError) as error:
        console.print(f"[red]{escape(error.detail)}[/]")
        if error.advice:
            console.print(escape(error.advice))
        return 1 if isinstance(error, ClientError) else 2
    output = request.output or Path(_file_name(sheet, kind))
    try:
        output.write_bytes(WRITERS[kind](sheet))
    except OSError as error:
        console.print(f"[red]{escape(str(output))} cannot be written: {error.strerror}.[/]")
        console.print("Name a file in a folder that is there and may be written to: --output FILE.")
        return 1
    _tell(console, sheet, output)
    return 0


def _kind(request: Request) -> str:
    """Return pdf or svg, by the option or the file's name."""
    if request.output is None:
        return request.kind or "pdf"
    suffix = request.output.suffix.lower().removeprefix(".")
    if request.kind is not None:
        if suffix in WRITERS and suffix != request.kind:
            raise InvalidArgument(
                f"{request.output.name} is to be {suffix} by its name, and {request.kind} by --format.",
                "Leave --format away, or call the file what it is.",
            )
        return request.kind
    if suffix not in WRITERS:
        raise InvalidArgument(
            f"{request.output} does not say what kind of file it is to be.",
            "Call it .pdf or .svg, or give --format.",
        )
    return suffix


def _file_name(sheet: Sheet, kind: str) -> str:
    target = sheet.target
    size = f"{target.columns}x{target.rows}-{target.pitch_mm:g}mm"
    return f"{target.kind}-{size}-{sheet.paper.name}.{kind}"


def _tell(console: Console, sheet: Sheet, output: Path) -> None:
    console.print(f"{escape(str(output))}: {sheet.paper}")
    console.print(escape(sheet.title))
    console.print(
        "Print at 100 %, with fitting to the page off. Then lay a steel rule along the ruler below it "
        f"(0 to {sheet.along_x.length:g} mm, along x) and the one on its left (0 to {sheet.along_y.length:g} mm, "
        "along y)."
    )
    console.print(
        "`gridpose target check` tells from photographs whether the print is square, true and flat."
    )
