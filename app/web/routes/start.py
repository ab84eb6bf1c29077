"""The first page: sessions with their headline, the service's health in words, what to do first."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from app.analyses.outcome import AnalysisRefused
from app.errors import NotFound
from app.records.tables import Robot, Target
from app.services.queries import visible
from app.services.readings import count_readings
from app.services.sessions import SessionDetail, search_sessions
from app.web.analyses import REPEATABILITY, analysis_document
from app.web.health import look
from app.web.pages import page_router, query_of, render
from app.web.routes.repeatability import source_by_itself
from app.web.service import Service, service_of

router = page_router()
otherwise = page_router()
PAGE_SIZE = 25
Text = Annotated[str, Query(max_length=200)]


@dataclass(frozen=True, slots=True)
class Headline:
    """The worst pose of a session's repeatability, or the `reason` why it has no figure."""

    pose_id: str | None = None
    rp_l_mm: float | None = None
    interval: list[float] | None = None
    verdict: str | None = None
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class SessionRow:
    """One line of the list; `readings` are another instrument's, and `headline` is None where the analysis has not been
    computed since the last change.
    """

    detail: SessionDetail
    readings: int
    robot: str | None
    headline: Headline | None


@router.get("", operation_id="list_sessions")
def lead_to_start(request: Request) -> Response:
    """Lead to the address with the slash, below which all pages are."""
    return RedirectResponse("/ui/", status_code=303)


@router.get("/", operation_id="list_sessions")
async def show_start(
    request: Request,
    q: Text = "",
    robot: Annotated[str, Query(max_length=64)] = "",
    page: Annotated[int, Query(ge=1, le=1_000_000)] = 1,
) -> Response:
    """Show the sessions, newest first."""
    service = service_of(request)
    found = await run_in_threadpool(_read, service, q, robot, page)
    is_list = request.headers.get("hx-target") == "sessions"
    return render(
        request,
        "sessions/_sessions.html" if is_list else "start.html",
        health=None if is_list else await look(request),
        q=q,
        robot=robot,
        page=page,
        pages=max(1, -(-found["total"] // PAGE_SIZE)),
        page_address=lambda number: f"/ui/{query_of({'q': q, 'robot': robot}, page=number)}",
        url=str(request.base_url).rstrip("/"),
        **found,
    )


@router.get("/sessions/{session_id}/headline", operation_id="get_repeatability")
async def show_headline(request: Request, session_id: str) -> Response:
    """Compute a session's headline, for the list, which shows it when it comes."""
    source = await run_in_threadpool(source_by_itself, service_of(request), session_id)
    settings = {**REPEATABILITY, "source": source}
    document = await analysis_document(request, "repeatability", session_id, settings)
    found = Headline(reason=document.detail) if isinstance(document, AnalysisRefused) else headline(document)
    return render(request, "sessions/_headline.html", session_id=session_id, headline=found)


@otherwise.get("/{path:path}", operation_id="list_sessions")
def show_nothing(request: Request, path: str) -> Response:
    """Say that there is no such page."""
    raise NotFound("There is no such page.", "Begin from the list of sessions.")


def headline(document: Mapping[str, Any]) -> Headline:
    """Return what a repeatability document comes to: its largest RP_l."""
    poses = [pose for pose in document["poses"] if pose["repeatability"]["rp_l_mm"] is not None]
    if not poses:
        return Headline(reason="No pose has two cycles yet.")
    worst = max(poses, key=lambda pose: pose["repeatability"]["rp_l_mm"])
    return Headline(
        worst["pose_id"], worst["repeatability"]["rp_l_mm"], worst["interval"]["rp_l_mm"], worst["verdict"]
    )


def _read(service: Service, q: str, robot: str, page: int) -> dict[str, Any]:
    with service.installation.database.read() as records:
        details, total = search_sessions(
            records, text=q.strip(), robot_id=robot or None, page_number=page, size=PAGE_SIZE
        )
        robots = {
            row.id: row.name
            for row in records.execute(
                sa.select(Robot.id, Robot.name).where(*visible(Robot)).order_by(Robot.name).limit(500)
            )
        }
        targets = records.scalar(sa.select(sa.func.count()).select_from(Target).where(*visible(Target))) or 0
        readings = count_readings(records, [detail.session.id for detail in details])
    rows = [
        SessionRow(
            detail,
            readings[detail.session.id],
            robots.get(detail.session.robot_id or ""),
            _kept_headline(service, detail, readings[detail.session.id]),
        )
        for detail in details
    ]
    return {"rows": rows, "total": total, "robots": robots, "targets": targets}


def _kept_headline(service: Service, detail: SessionDetail, readings: int) -> Headline | None:
    source = "measured_poses" if readings and not any(detail.counts.values()) else "images"
    settings = {**REPEATABILITY, "source": source}
    kept = service.analyses.kept("repeatability", detail.session.id, settings)
    if kept is None:
        return None
    return Headline(reason=kept.detail) if isinstance(kept, AnalysisRefused) else headline(json.loads(kept))
