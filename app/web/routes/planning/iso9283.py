"""The cube of a test by ISO 9283: its poses, what the session will show, and the files to take to the robot."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from fastapi import Depends, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.analyses.computations import compute_test_plan
from app.errors import Conflict, InvalidContent, NotFound
from app.http import get_requester, run_while_connected
from app.records.tables import Target, target_fields
from app.services.queries import get_or_raise
from app.web.pages import page_router, render
from app.web.routes.planning.session_advice import known_targets, require_computing
from app.web.service import Service, service_of

router = page_router()
PLANES = ("C1-C2-C7-C8", "C2-C3-C8-C5", "C3-C4-C5-C6", "C4-C1-C6-C7")
_TYPES = {"json": "application/json", "csv": "text/csv; charset=utf-8", "pdf": "application/pdf"}
_Length = Annotated[float, Query(gt=0.0, le=100_000.0, allow_inf_nan=False)]
_Text = Annotated[str, Query(max_length=100)]


@dataclass
class AskedPlan:
    """The fields of the form, by the query."""

    target: Annotated[str, Query(max_length=64)] = ""
    side_mm: _Length = 200.0
    centre_mm: _Text = "0, 0, 0"
    orientation_deg: _Text = "180, 0, 0"
    plane: Annotated[str, Query(max_length=11)] = PLANES[0]
    focal_length_mm: _Length = 8.0
    pixel_pitch_um: _Length = 3.45
    width: Annotated[int, Query(ge=16, le=65_535)] = 2448
    height: Annotated[int, Query(ge=16, le=65_535)] = 2050
    distance_mm: _Length = 700.0
    tilt_deg: Annotated[float, Query(ge=0.0, lt=80.0, allow_inf_nan=False)] = 20.0
    cycles: Annotated[int, Query(ge=2, le=200)] = 30
    rp_mm: _Length = 0.05
    limit_mm: Annotated[str, Query(max_length=20)] = ""


AskedDep = Annotated[AskedPlan, Depends()]


@router.get("/plans/iso9283", operation_id="list_targets")
async def show_test_plan(request: Request, asked: AskedDep) -> Response:
    """Ask for cube, camera and target; show the poses and what the session will show."""
    require_computing(request)
    targets = await run_in_threadpool(_targets, service_of(request))
    plan: dict[str, Any] | None = None
    refused: Conflict | InvalidContent | None = None
    if asked.target:
        try:
            plan = json.loads(await _computed(request, asked, ".json"))
        except (Conflict, InvalidContent) as reason:
            refused = reason
    return render(
        request,
        "planning/iso9283.html",
        asked=asdict(asked),
        targets=targets,
        planes=PLANES,
        plan=plan,
        refused=refused,
        url=str(request.base_url).rstrip("/"),
    )


@router.get("/plans/iso9283.{form}", operation_id="list_targets")
async def get_test_plan(request: Request, form: str, asked: AskedDep) -> Response:
    """Give the plan as a file: its document, the commanded poses as a table, or a check list to print."""
    require_computing(request)
    if form not in _TYPES:
        raise NotFound("There is no such file.", "A plan is written as json, csv or pdf.")
    content = await _computed(request, asked, f".{form}")
    headers = {"Content-Disposition": f'attachment; filename="iso9283.{form}"', "Cache-Control": "no-store"}
    return Response(content, media_type=_TYPES[form], headers=headers)


async def _computed(request: Request, asked: AskedPlan, suffix: str) -> bytes:
    """Return a plan as a file. Raises NotFound for its target, InvalidContent, Conflict where it cannot be planned."""
    service = service_of(request)
    target = await run_in_threadpool(_target, service, asked.target)
    wanted = {
        "centre_mm": _three("centre_mm", asked.centre_mm),
        "orientation_deg": _three("orientation_deg", asked.orientation_deg),
        "side_mm": asked.side_mm,
        "focal_px": 1000.0 * asked.focal_length_mm / asked.pixel_pitch_um,
        "size_px": (asked.width, asked.height),
        "plane": asked.plane,
        "distance_mm": asked.distance_mm,
        "tilt_deg": asked.tilt_deg,
        "cycles": asked.cycles,
        "rp_mm": asked.rp_mm,
        "limit_mm": _limit(asked.limit_mm),
    }
    question = ("iso9283", repr((target, wanted, suffix)))
    requester = await get_requester(request)
    planned = service.analyses.worked_out(question, requester, compute_test_plan, target, wanted, suffix)
    return await run_while_connected(request, planned)


def _three(name: str, text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.replace(",", " ").split())
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(math.isfinite(one) and abs(one) < 1e6 for one in numbers):
        raise InvalidContent(
            f"{text[:40]!r} is not three numbers.",
            "Write three numbers with commas between: 900, 0, 450.",
            errors=[(name, "is not three numbers")],
        )
    return numbers


def _limit(text: str) -> float | None:
    """Return the data sheet's repeatability, mm; None where none is stated."""
    if not text.strip():
        return None
    try:
        limit = float(text.replace(",", "."))
    except ValueError:
        limit = math.nan
    if not (math.isfinite(limit) and limit > 0.0):
        raise InvalidContent(
            f"{text[:20]!r} is no length.",
            "Write the repeatability of the data sheet in mm, or leave it empty.",
            errors=[("limit_mm", "is no length")],
        )
    return limit


def _targets(service: Service) -> list[Target]:
    with service.installation.database.read() as records:
        return known_targets(records)


def _target(service: Service, target_id: str) -> dict[str, Any]:
    with service.installation.database.read() as records:
        return target_fields(get_or_raise(records, Target, target_id))
