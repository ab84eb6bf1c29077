"""`gridpose target check`: from photographs of a print, how far it is from what it states."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import stamina
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from app.agent import ClientError, Json
from app.cli.target_options import TargetOptions, chosen_target, stored_target
from app.cli.upload import find_session
from app.printing.identity import sheet_id_of
from app.printing.sheet import describe
from core import GridPoints, GridposeError, TargetSpec
from core.calibration.print_check import (
    LEAST_DIRECTIONS,
    Finding,
    PrintCheck,
    PrintedShape,
    RuleReading,
    check_asked,
    check_print,
)
from core.calibration.readings import turns_alike
from core.calibration.shape_departures import Measure
from core.calibration.target_shape import estimate_target_shape
from core.errors import InvalidArgument, InvalidInput, TargetShapeNotObservable
from core.image import decode
from core.targets.detect import check_detectable, detect

MOST_PHOTOS = 60
"""More tell next to nothing new, and the estimate's time grows with them."""
_READING = re.compile(r"(?P<along>[xy]):(?P<stated>[0-9]*\.?[0-9]+):(?P<read>[0-9]*\.?[0-9]+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """The options of `gridpose target check`."""

    photos: tuple[Path, ...]
    session: str | None
    target: TargetOptions
    readings: tuple[str, ...]
    reading_u_mm: float
    limit_percent: float
    as_json: bool


@dataclass(frozen=True, slots=True)
class _Looked:
    """A print's shape, and what it was estimated from."""

    shape: PrintedShape
    photos: int
    directions: int
    rms_px: float
    skipped: tuple[tuple[str, str, str], ...]
    """File, code and detail of each photo that was left out."""
    warnings: tuple[str, ...]


def check_target(request: Request) -> int:
    """Estimate, compare, tell, and return the exit code."""
    errors = Console(stderr=True, highlight=False, soft_wrap=True)
    stamina.instrumentation.set_on_retry_hooks([])
    try:
        readings = [_reading(text, request.reading_u_mm) for text in request.readings]
        if not 0.0 < request.limit_percent < 100.0:
            raise InvalidArgument(
                f"--limit-percent must be more than 0 and less than 100, got {request.limit_percent:g}.",
                "It is how far the print may be off, in percent of the grid's longer side: .1 where nothing is said.",
            )
        limit = request.limit_percent / 100.0
        check_asked(readings, limit)
        looked = _from_session(request) if request.session is not None else _from_photos(request, errors)
        check = check_print(looked.shape, readings, limit=limit)
    except (GridposeError, ClientError) as error:
        errors.print(f"[red]{escape(error.detail)}[/]")
        if error.advice:
            errors.print(escape(error.advice))
        return 2 if isinstance(error, InvalidInput) else 1
    if request.as_json:
        print(json.dumps(_document(looked, check), indent=2, allow_nan=False))
    else:
        _show(Console(highlight=False, soft_wrap=True), looked, check)
    return 0 if check.verdict == "fine" else 1


def _reading(text: str, u_mm: float) -> RuleReading:
    match = _READING.fullmatch(text.strip())
    if match is None:
        raise InvalidArgument(
            f"--measured-mm {text!r} is no reading of a rule.",
            "Write SIDE:STATED:READ in mm, e.g. x:250:249.2 for 249.2 mm between the marks 0 and 250 along x.",
        )
    along: Any = match["along"]
    return RuleReading(along, float(match["stated"]), float(match["read"]), u_mm)


def _from_photos(request: Request, errors: Console) -> _Looked:
    if not request.photos:
        raise InvalidArgument(
            "No photographs are named.", "Name ten or more of the print, or a --session of a service."
        )
    target = chosen_target(request.target).target
    check_detectable(target)
    skipped: list[tuple[str, str, str]] = []
    views: list[GridPoints] = []
    with errors.status("looking for the target") as status:
        for number, path in enumerate(request.photos, start=1):
            status.update(f"looking for the target: {number} of {len(request.photos)}")
            try:
                views.append(_whole_view(path, target))
            except GridposeError as error:
                skipped.append((path.name, error.code, error.detail))
            except OSError as error:
                skipped.append((path.name, "unreadable_file", f"The file cannot be read: {error.strerror}."))
        if not views:
            _tell_skipped(errors, skipped)
            raise TargetShapeNotObservable(
                f"The {describe(target)} was found in none of {len(request.photos)} photographs.",
                "Check what the sheet says of itself, and that the photographs show the print sharp and whole.",
            )
        status.update("estimating the print's shape")
        sizes = Counter((v.image_width_px, v.image_height_px) for v in views)
        (width, height), most = sizes.most_common(1)[0]
        if most < len(views):
            skipped.append(
                (
                    f"{len(views) - most} photographs",
                    "other_size",
                    f"Their size is not {width} x {height} pixels as the others': another camera, or cropped.",
                )
            )
        same = [v for v in views if (v.image_width_px, v.image_height_px) == (width, height)]
        warnings = _about_turns(target, same)
        chosen = [same[i] for i in _spread(len(same))]
        try:
            shape = estimate_target_shape(chosen, least_directions=LEAST_DIRECTIONS)
        except GridposeError:
            _tell_skipped(errors, skipped)
            raise
    return _Looked(
        PrintedShape.of(shape),
        len(shape.used_views),
        shape.directions,
        shape.rms_px,
        tuple(skipped),
        warnings,
    )


def _whole_view(path: Path, target: TargetSpec) -> GridPoints:
    view = detect(decode(path.read_bytes()), target)
    if view.origin == "unknown":
        raise TargetShapeNotObservable("Part of the board is in view, and which part is not told.")
    return view


def _about_turns(target: TargetSpec, views: list[GridPoints]) -> tuple[str, ...]:
    """Return what it means that a board looks the same when turned; raises where its sides cannot be told apart."""
    turns = len(turns_alike(target)) if any(v.origin == "turned" for v in views) else 1
    if turns == 4:
        raise TargetShapeNotObservable(
            "This board looks the same turned by 90°: which of its sides is x cannot be told from photographs.",
            "Print it with marked squares (--marks) or a larger dot at its origin (--origin-dot), or another size.",
        )
    if turns == 1:
        return ()
    return (
        "This board looks the same turned by 180°: a single point's departure may be that of the point opposite. "
        "Stretch, squareness and bow are not touched by that.",
    )


def _spread(count: int) -> list[int]:
    return np.unique(np.linspace(0, count - 1, min(count, MOST_PHOTOS)).round().astype(int)).tolist()


def _from_session(request: Request) -> _Looked:
    if request.photos:
        raise InvalidArgument("Photographs and a session are both named.", "Name the one or the other.")
    told = [*(["--target-id"] if request.target.target_id is not None else []), *request.target.description]
    if told:
        raise InvalidArgument(
            f"--session already says what {', '.join(told)} would: its images were searched for its own targets.",
            "Name the session alone, or photographs and what they show.",
        )
    with request.target.service.client() as client:
        session_id = find_session(client, str(request.session))["id"]
        document = client.get(f"/v1/sessions/{session_id}/intrinsics", refine_target=True)["target_shape"]
        target = stored_target(client.get(f"/v1/targets/{document['target_id']}")).target

    def measure(name: str, factor: float = 1.0) -> Measure:
        entry = document[name]
        return Measure(factor * entry["value"], factor * entry["standard_uncertainty"])

    def column(of: Callable[[Json], Any]) -> np.ndarray[Any, Any]:
        return np.array([of(point) for point in document["points"]])

    shape = PrintedShape(
        target,
        column(lambda point: point["column"]),
        column(lambda point: point["row"]),
        column(lambda point: point["departure_mm"]),
        column(lambda point: point["standard_uncertainty_mm"]),
        measure("bow_x_mm"),
        measure("bow_y_mm"),
        measure("twist_mm"),
        measure("aspect"),
        measure("shear_deg", math.radians(1.0)),
    )
    return _Looked(shape, document["images"], document["directions"], document["rms_px"], (), ())


_NO_LENGTH = (
    "Photographs tell no length: whether the print as a whole is larger or smaller than stated is open. Lay a steel "
    "rule along the sheet's rulers and add what it reads, e.g. --measured-mm x:250:249.8 --measured-mm y:150:150.1."
)


def _document(looked: _Looked, check: PrintCheck) -> Json:
    target = looked.shape.target

    def pitch(measure: Measure | None) -> Json | None:
        if measure is None:
            return None
        return {"value": measure.value, "standard_uncertainty": measure.standard_uncertainty}

    return {
        "target": {name: value for name, value in asdict(target).items() if value is not None},
        "sheet_id": sheet_id_of(target),
        "photos": looked.photos,
        "directions": looked.directions,
        "rms_px": looked.rms_px,
        "skipped": [{"file": f, "code": code, "detail": detail} for f, code, detail in looked.skipped],
        "verdict": check.verdict,
        "findings": [asdict(finding) for finding in check.findings],
        "pitch_x_mm": pitch(check.pitch_x_mm),
        "pitch_y_mm": pitch(check.pitch_y_mm),
        "warnings": [*looked.warnings, *([] if check.pitch_x_mm else [_NO_LENGTH])],
    }


def _show(console: Console, looked: _Looked, check: PrintCheck) -> None:
    target = looked.shape.target
    console.print(
        f"{escape(describe(target))}: {looked.photos} photographs from {looked.directions} directions, "
        f"residuals {looked.rms_px:.2g} px"
    )
    table = Table(
        title="Judged by value ± expanded uncertainty (95 %) against the limit", title_justify="left"
    )
    for header in ("", "", "limit", "what to do"):
        table.add_column(header, overflow="fold")
    colours = {"off": "red", "undecided": "yellow", "fine": "green"}
    for finding in check.findings:
        colour = colours[finding.verdict]
        limit = escape(_limit(finding))
        table.add_row(
            f"[{colour}]{finding.verdict}[/]", escape(finding.detail), limit, escape(_advice(finding))
        )
    console.print(table)
    _tell_skipped(console, looked.skipped)
    for warning in looked.warnings:
        console.print(f"[yellow]{escape(warning)}[/]")
    if check.pitch_x_mm is None:
        console.print(escape(_NO_LENGTH))
    console.print(
        {
            "fine": "The print is as stated, within the limit.",
            "off": "The print is not as stated.",
            "undecided": "The photographs leave open whether the print is as stated.",
        }[check.verdict]
    )


def _limit(finding: Finding) -> str:
    if finding.unit == "mm":
        return f"{finding.limit:.2g} mm"
    return (
        f"{math.degrees(finding.limit):.2g}°" if finding.unit == "rad" else f"{100.0 * finding.limit:.2g} %"
    )


def _advice(finding: Finding) -> str:
    return finding.advice or ""


def _tell_skipped(
    console: Console, skipped: list[tuple[str, str, str]] | tuple[tuple[str, str, str], ...]
) -> None:
    for name, code, detail in skipped:
        console.print(f"[yellow]left out: {escape(name)}: {escape(detail)} ({code})[/]")
