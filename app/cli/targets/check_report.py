"""Report of `gridpose targets check`: a table for people, a document for programs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.client import Json
from app.printing import describe, sheet_id_of
from core.calibration import Measure, PrintCheck, PrintedShape, PrintFinding


@dataclass(frozen=True, slots=True)
class ShapeEstimate:
    """The estimated shape of a print, and the photographs it was estimated from."""

    shape: PrintedShape
    photos: int
    directions: int
    rms_px: float
    skipped: tuple[tuple[str, str, str], ...]
    """File, code and detail of each photograph that was skipped."""
    warnings: tuple[str, ...]


_NO_LENGTH = (
    "Photographs do not determine the scale: the print as a whole may be larger or smaller than stated. Lay a steel "
    "rule along the sheet's rulers and add its readings, e.g. --ruler x:250:249.8 --ruler y:150:150.1."
)


def document(estimate: ShapeEstimate, check: PrintCheck) -> Json:
    """Return the report as JSON."""
    target = estimate.shape.target

    def pitch(measure: Measure | None) -> Json | None:
        if measure is None:
            return None
        return {"value": measure.value, "standard_uncertainty": measure.standard_uncertainty}

    return {
        "target": {name: value for name, value in asdict(target).items() if value is not None},
        "sheet_id": sheet_id_of(target),
        "photos": estimate.photos,
        "directions": estimate.directions,
        "rms_px": estimate.rms_px,
        "skipped": [{"file": f, "code": code, "detail": detail} for f, code, detail in estimate.skipped],
        "verdict": check.verdict,
        "findings": [asdict(finding) for finding in check.findings],
        "pitch_x_mm": pitch(check.pitch_x_mm),
        "pitch_y_mm": pitch(check.pitch_y_mm),
        "warnings": [*estimate.warnings, *([] if check.pitch_x_mm else [_NO_LENGTH])],
    }


def show(console: Console, estimate: ShapeEstimate, check: PrintCheck) -> None:
    """Print the report."""
    target = estimate.shape.target
    console.print(
        f"{escape(describe(target))}: {estimate.photos} photographs from {estimate.directions} directions, "
        f"residuals {estimate.rms_px:.2g} px"
    )
    table = Table(title="Value ± expanded uncertainty (95 %) against the limit", title_justify="left")
    for header in ("", "", "limit", "what to do"):
        table.add_column(header, overflow="fold")
    colours = {"off": "red", "undecided": "yellow", "fine": "green"}
    for finding in check.findings:
        colour = colours[finding.verdict]
        limit = escape(_limit(finding))
        table.add_row(
            f"[{colour}]{finding.verdict}[/]", escape(finding.detail), limit, escape(finding.advice or "")
        )
    console.print(table)
    list_skipped(console, estimate.skipped)
    for warning in estimate.warnings:
        console.print(f"[yellow]{escape(warning)}[/]")
    if check.pitch_x_mm is None:
        console.print(escape(_NO_LENGTH))
    console.print(
        {
            "fine": "The print is as stated, within the limit.",
            "off": "The print is not as stated.",
            "undecided": "The photographs do not determine whether the print is as stated.",
        }[check.verdict]
    )


def _limit(finding: PrintFinding) -> str:
    if finding.unit == "mm":
        return f"{finding.limit:.2g} mm"
    return (
        f"{math.degrees(finding.limit):.2g}°" if finding.unit == "rad" else f"{100.0 * finding.limit:.2g} %"
    )


def list_skipped(console: Console, skipped: Sequence[tuple[str, str, str]]) -> None:
    """Print the photographs that were skipped, with the reasons."""
    for name, code, detail in skipped:
        console.print(f"[yellow]skipped: {escape(name)}: {escape(detail)} ({code})[/]")
