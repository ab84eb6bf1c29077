"""Robots, and what a session identifies of one: its parameters against the data sheet."""

from __future__ import annotations

from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.analyses.computations import compute_robot_file
from app.analyses.documents.robot_files import CHAIN_FILES
from app.analyses.outcome import AnalysisRefused
from app.analyses.reporting import DH_DEFAULTS
from app.errors import Conflict, NotFound
from app.http import get_requester
from app.records.tables import Robot, Session
from app.services.queries import get_or_raise, page_by_name, visible
from app.web.analyses import analysis_document, image_names
from app.web.pages import is_fragment, page_router, render
from app.web.robot_parameters import joint_rows, objections, weak_joints
from app.web.routes.repeatability import SourceText, chosen_source, head_of, settings_of
from app.web.service import service_of

router = page_router()
ROBOT_FILES = {
    "robot.urdf": "application/xml",
    "robot.yaml": "application/yaml",
    "robot.csv": "text/csv; charset=utf-8",
    "terms.json": "application/json",
}
"""The identified robot for other programs: names and media types."""


@router.get("/robots", operation_id="list_robots")
def show_robots(request: Request, cursor: Annotated[str | None, Query(max_length=200)] = None) -> Response:
    """Show the robots, and the form to add one."""
    with service_of(request).installation.database.read() as records:
        robots, next_cursor = page_by_name(records, Robot, limit=200, cursor=cursor)
        return render(request, "robots/robots.html", robots=robots, next_cursor=next_cursor)


@router.get("/robots/{robot_id}", operation_id="get_robot")
def show_robot(request: Request, robot_id: str) -> Response:
    """Show a robot's data sheet and its sessions, newest first."""
    with service_of(request).installation.database.read() as records:
        robot = get_or_raise(records, Robot, robot_id)
        sessions = records.scalars(
            sa.select(Session)
            .where(Session.robot_id == robot_id, *visible(Session))
            .order_by(Session.id.desc())
            .limit(200)
        ).all()
        return render(request, "robots/robot.html", robot=robot, sessions=sessions)


@router.get("/sessions/{session_id}/robot", operation_id="get_dh")
async def show_identification(
    request: Request,
    session_id: str,
    source: SourceText = "",
    compute: Annotated[str, Query(max_length=4)] = "",
) -> Response:
    """Show the robot's parameters as the session identifies them; they take seconds, so that the page comes first."""
    context = await run_in_threadpool(head_of, service_of(request), session_id, "robot")
    settings = _settings(await chosen_source(request, session_id, source))
    shown: dict[str, Any] = {**context, "source": settings["source"]}
    if not compute and not is_fragment(request):
        return render(
            request,
            "analyses/identification.html",
            **shown,
            computed=False,
            refused=None,
            document=None,
            joints=[],
            objections=[],
            weak_joints=[],
        )
    found = await analysis_document(request, "dh", session_id, settings)
    refused = found if isinstance(found, AnalysisRefused) else None
    document = None if isinstance(found, AnalysisRefused) else found
    return render(
        request,
        "analyses/_identification.html" if is_fragment(request) else "analyses/identification.html",
        **shown,
        computed=True,
        refused=refused,
        document=document,
        image_names=await image_names(request, found),
        joints=joint_rows(document) if document else [],
        objections=objections(document) if document else [],
        weak_joints=weak_joints(document) if document else [],
    )


@router.get("/sessions/{session_id}/robot/files/{name}", operation_id="get_dh")
async def get_robot_file(request: Request, session_id: str, name: str, source: SourceText = "") -> Response:
    """Answer with the identified robot as a file of another program."""
    if name not in ROBOT_FILES:
        raise NotFound("There is no such file of a robot.", f"Choose one of {', '.join(ROBOT_FILES)}.")
    service = service_of(request)
    context = await run_in_threadpool(head_of, service, session_id, "robot")
    settings = _settings(await chosen_source(request, session_id, source))
    if name in CHAIN_FILES:
        settings["model"] = "dh"
    document = await analysis_document(request, "dh", session_id, settings)
    if isinstance(document, AnalysisRefused):
        raise Conflict(document.detail, document.advice, code=document.code)
    robot = context["robot"]
    sheet = None if robot is None else {"name": robot.name, "joints": robot.joints}
    asked = (document, sheet, context["session"].name, name)
    made = await service.analyses.worked_out(
        ("robot_file", repr(asked)), await get_requester(request), compute_robot_file, *asked
    )
    if not made:
        raise NotFound(
            f"The identified robot cannot be written as {name}.",
            "The page of the robot lists the files that it can.",
        )
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(made, media_type=ROBOT_FILES[name], headers=headers)


def _settings(source: str) -> dict[str, str]:
    """Return the settings that `GET .../dh` has by default."""
    return {**DH_DEFAULTS, "source": settings_of("", source)["source"]}
