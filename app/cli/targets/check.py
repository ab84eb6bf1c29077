"""`gridpose targets check`: the shape of a print, estimated from photographs, against its description."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console

from app.cli.options.access import ReadAccess
from app.cli.targets.check_report import ShapeEstimate, document, list_skipped, show
from app.cli.targets.options import TargetOptions, choose_target, stored_target
from app.client import ClientError, Json, find_session
from app.client.commands import error_console, print_error, print_json
from app.printing import describe
from core import GridPoints, GridposeError, TargetSpec
from core.calibration import (
    MIN_CHECK_DIRECTIONS,
    Measure,
    PrintedShape,
    RuleReading,
    check_asked,
    check_print,
    estimate_target_shape,
    symmetry_rotations,
)
from core.errors import InvalidArgument, InvalidInput, TargetShapeNotObservable
from core.image import decode
from core.targets import check_detectable, detect

_MAX_PHOTOS = 60
"""More add almost no information, and the time of the estimate grows with them."""
_READING = re.compile(r"(?P<along>[xy]):(?P<stated>[0-9]*\.?[0-9]+):(?P<read>[0-9]*\.?[0-9]+)")


def check_target(
    options: TargetOptions,
    service: ReadAccess,
    photos: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Photographs of the print: one camera at one focus, ten or more, tilted to all sides and rotated.",
            exists=True,
            dir_okay=False,
        ),
    ] = None,
    session: Annotated[
        str | None, typer.Option(help="Id or name of a service's session, instead of photographs.")
    ] = None,
    measured_mm: Annotated[
        list[str] | None,
        typer.Option(
            "--ruler",
            help="SIDE:NOMINAL:MEASURED, the reading of a steel rule along a ruler of the sheet (or between two grid "
            "points of one row), e.g. x:250:249.2; for either side, repeatable.",
        ),
    ] = None,
    measured_u_mm: Annotated[
        float, typer.Option("--ruler-sigma-mm", help="Standard uncertainty of such a reading.", min=1e-6)
    ] = 0.1,
    limit_percent: Annotated[
        float,
        typer.Option(
            "--tolerance-percent",
            help="Permitted deviation of the print, in percent of the grid's longer side.",
        ),
    ] = 0.1,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> int:
    """Determine from photographs how a print differs from its description: stretch, squareness, flatness.

    Ends with 0 when all is within the limit, 1 when something is not or cannot be determined, 2 when the options are
    invalid.
    """
    errors = error_console()
    try:
        readings = [_reading(text, measured_u_mm) for text in measured_mm or ()]
        if not 0.0 < limit_percent < 100.0:
            raise InvalidArgument(
                f"--tolerance-percent must be more than 0 and less than 100, got {limit_percent:g}.",
                "It is the permitted deviation in percent of the grid's longer side; the default is 0.1.",
            )
        limit = limit_percent / 100.0
        check_asked(readings, limit)
        if session is not None:
            estimate = _from_session(session, photos or (), options, service)
        else:
            estimate = _from_photos(photos or (), options, service, errors)
        check = check_print(estimate.shape, readings, limit=limit)
    except (GridposeError, ClientError) as error:
        print_error(errors, error.detail, error.advice)
        return 2 if isinstance(error, InvalidInput) else 1
    if as_json:
        print_json(document(estimate, check))
    else:
        show(Console(highlight=False, soft_wrap=True, emoji=False), estimate, check)
    return 0 if check.verdict == "fine" else 1


def _reading(text: str, u_mm: float) -> RuleReading:
    match = _READING.fullmatch(text.strip())
    if match is None:
        raise InvalidArgument(
            f"--ruler {text!r} is not a reading of a rule.",
            "Write SIDE:NOMINAL:MEASURED in mm, e.g. x:250:249.2 for 249.2 mm between the marks 0 and 250 along x.",
        )
    along: Any = match["along"]
    return RuleReading(along, float(match["stated"]), float(match["read"]), u_mm)


def _from_photos(
    photos: Sequence[Path], options: TargetOptions, service: ReadAccess, errors: Console
) -> ShapeEstimate:
    if not photos:
        raise InvalidArgument(
            "No photographs are given.", "Give ten or more of the print, or a --session of a service."
        )
    target = choose_target(options, service).target
    check_detectable(target)
    skipped: list[tuple[str, str, str]] = []
    views: list[GridPoints] = []
    with errors.status("searching for the target") as status:
        for number, path in enumerate(photos, start=1):
            status.update(f"searching for the target: {number} of {len(photos)}")
            try:
                views.append(detect(decode(path.read_bytes()), target))
            except GridposeError as error:
                skipped.append((path.name, error.code, error.detail))
            except OSError as error:
                skipped.append((path.name, "unreadable_file", f"The file cannot be read: {error.strerror}."))
        if not views:
            list_skipped(errors, skipped)
            raise TargetShapeNotObservable(
                f"The {describe(target)} was found in none of {len(photos)} photographs.",
                "Compare the options with the text on the sheet; the photographs must show the whole print sharply.",
            )
        status.update("estimating the print's shape")
        sizes = Counter((v.image_width_px, v.image_height_px) for v in views)
        (width, height), most = sizes.most_common(1)[0]
        if most < len(views):
            skipped.append(
                (
                    f"{len(views) - most} photographs",
                    "other_size",
                    f"Their size is not {width} x {height} pixels as that of the others: another camera, or cropped.",
                )
            )
        same = [v for v in views if (v.image_width_px, v.image_height_px) == (width, height)]
        warnings = _symmetry_warnings(target, same)
        chosen = [same[i] for i in _evenly(len(same))]
        try:
            shape = estimate_target_shape(chosen, least_directions=MIN_CHECK_DIRECTIONS)
        except GridposeError:
            list_skipped(errors, skipped)
            raise
    return ShapeEstimate(
        PrintedShape.of(shape),
        len(shape.used_views),
        shape.directions,
        shape.rms_px,
        tuple(skipped),
        warnings,
    )


def _symmetry_warnings(target: TargetSpec, views: list[GridPoints]) -> tuple[str, ...]:
    """Return the warnings of a symmetric board; raises where its sides cannot be distinguished."""
    turns = len(symmetry_rotations(target)) if any(v.labelling == "up_to_symmetry" for v in views) else 1
    if turns == 4:
        raise TargetShapeNotObservable(
            "This board looks the same turned by 90°: photographs do not determine which of its sides is x.",
            "Print it with fiducial dots (--fiducials) or a larger dot at its origin (--origin-dot-ratio), or another "
            "size.",
        )
    if turns == 1:
        return ()
    return (
        "This board looks the same turned by 180°: a single point's deviation may be that of the opposite point. "
        "Stretch, squareness and bow are not affected.",
    )


def _evenly(count: int) -> list[int]:
    return np.unique(np.linspace(0, count - 1, min(count, _MAX_PHOTOS)).round().astype(int)).tolist()


def _from_session(
    session: str, photos: Sequence[Path], options: TargetOptions, service: ReadAccess
) -> ShapeEstimate:
    if photos:
        raise InvalidArgument("Photographs and a session are both given.", "Give one of them.")
    described = [*(["--target-id"] if options.target_id is not None else []), *options.given]
    if described:
        raise InvalidArgument(
            f"--session excludes {', '.join(described)}: its images are searched for its own targets.",
            "Give the session alone, or photographs and their target.",
        )
    with service.client(error_console()) as client:
        session_id = find_session(client, session)["id"]
        answer = client.get(f"/v1/sessions/{session_id}/intrinsics", refine_target=True)["target_shape"]
        target = stored_target(client.get(f"/v1/targets/{answer['target_id']}")).target

    def measure(name: str, factor: float = 1.0) -> Measure:
        return Measure(factor * answer[name], factor * answer["standard_uncertainty"][name])

    def column(of: Callable[[Json], Any]) -> np.ndarray[Any, Any]:
        return np.array([of(point) for point in answer["points"]])

    shape = PrintedShape(
        target,
        column(lambda point: point["column"]),
        column(lambda point: point["row"]),
        column(lambda point: point["deviation_mm"]),
        column(lambda point: point["deviation_sigma_mm"]),
        measure("bow_x_mm"),
        measure("bow_y_mm"),
        measure("twist_mm"),
        measure("aspect"),
        measure("shear_deg", math.radians(1.0)),
    )
    return ShapeEstimate(shape, answer["image_count"], answer["view_directions"], answer["rms_px"], (), ())
