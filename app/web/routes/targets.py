"""Targets: their list, and the design of one with a preview at true scale and a sheet to print."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query, Request
from starlette.responses import Response

from app.http import get_requester
from app.records.tables import Target
from app.services.queries import get_or_raise, page_by_name
from app.web.pages import page_router, render
from app.web.service import service_of

router = page_router()
KINDS = {
    "chessboard": "Chessboard",
    "charuco": "ChArUco",
    "circles": "Circles",
    "asymmetric_circles": "Asymmetric circles",
    "aprilgrid": "AprilGrid",
}
PAPERS = ("A4", "A3", "A2", "A1", "A0")
FITTING = ""
"""Stands for the smallest paper that the target fits on."""
_MEDIA_TYPES = {"pdf": "application/pdf", "svg": "image/svg+xml"}
_SHEET_POLICY = "default-src 'none'; style-src 'unsafe-inline'"


@router.get("/targets", operation_id="list_targets")
def show_targets(request: Request, cursor: Annotated[str | None, Query(max_length=200)] = None) -> Response:
    """Show the targets there are."""
    with service_of(request).installation.database.read() as records:
        targets, next_cursor = page_by_name(records, Target, limit=200, cursor=cursor)
        return render(request, "targets/targets.html", targets=targets, next_cursor=next_cursor, kinds=KINDS)


@router.get("/targets/new", operation_id="list_targets")
def show_new_target(request: Request) -> Response:
    """Design a target, with its sheet alongside."""
    return render(request, "targets/new_target.html", kinds=KINDS, papers=PAPERS)


@router.get("/targets/sheet.{form}", operation_id="list_targets")
async def get_sheet(
    request: Request,
    form: str,
    kind: Annotated[str, Query(max_length=32)] = "chessboard",
    columns: Annotated[int, Query(ge=2, le=500)] = 9,
    rows: Annotated[int, Query(ge=2, le=500)] = 6,
    pitch_mm: Annotated[float, Query(gt=0, le=10_000, allow_inf_nan=False)] = 25.0,
    marker_mm: Annotated[str, Query(max_length=20)] = "",
    dictionary: Annotated[str, Query(max_length=64)] = "",
    paper: Annotated[str, Query(max_length=2)] = FITTING,
    name: Annotated[str, Query(max_length=200)] = "",
) -> Response:
    """Draw a sheet that need not be stored: the preview while it is designed, and the file to print."""
    target = {
        "kind": kind,
        "columns": columns,
        "rows": rows,
        "pitch_mm": pitch_mm,
        "marker_mm": _length(marker_mm),
        "dictionary": dictionary or None,
    }
    return await _sheet(request, target, form, paper, name)


@router.get("/targets/{target_id}", operation_id="get_target")
def show_target(request: Request, target_id: str) -> Response:
    """Show one target with its certificate."""
    with service_of(request).installation.database.read() as records:
        target = get_or_raise(records, Target, target_id)
        return render(request, "targets/target.html", target=target, kinds=KINDS, papers=PAPERS)


@router.get("/targets/{target_id}/sheet.{form}", operation_id="get_target")
async def get_target_sheet(
    request: Request, target_id: str, form: str, paper: Annotated[str, Query(max_length=2)] = FITTING
) -> Response:
    """Draw a stored target's sheet."""
    with service_of(request).installation.database.read() as records:
        target = get_or_raise(records, Target, target_id)
    fields = {
        name: getattr(target, name)
        for name in ("kind", "columns", "rows", "pitch_mm", "marker_mm", "dictionary", "legacy_layout")
    }
    return await _sheet(request, fields, form, paper, target.name)


async def _sheet(request: Request, target: dict[str, Any], form: str, paper: str, name: str) -> Response:
    form = form if form in _MEDIA_TYPES else "svg"
    options = {"form": form, "papers": [paper] if paper in PAPERS else list(PAPERS), "name": name or None}
    drawn = await service_of(request).analyses.sheet(target, options, await get_requester(request))
    headers = {"Content-Security-Policy": _SHEET_POLICY, "Cache-Control": "private, no-cache"}
    if form == "pdf":
        headers["Content-Disposition"] = (
            f'inline; filename="{target["kind"]}-{target["columns"]}x{target["rows"]}.pdf"'
        )
    return Response(drawn, media_type=_MEDIA_TYPES[form], headers=headers)


def _length(text: str) -> float | None:
    try:
        return float(text) if text.strip() else None
    except ValueError:
        return None
