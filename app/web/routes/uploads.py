"""A new session, and adding images to one."""

from __future__ import annotations

from typing import Annotated

import sqlalchemy as sa
from fastapi import Query, Request
from starlette.responses import Response

from app.records.tables import Robot, Target
from app.services.queries import visible
from app.services.sessions import get_session
from app.web.pages import page_router, render
from app.web.routes.sessions import session_context
from app.web.service import service_of

router = page_router()


@router.get("/sessions/new", operation_id="list_sessions")
def show_new_session(request: Request, target: Annotated[str, Query(max_length=64)] = "") -> Response:
    """Ask for a session's target, robot and conditions."""
    with service_of(request).installation.database.read() as records:
        targets = records.scalars(
            sa.select(Target).where(*visible(Target)).order_by(Target.id.desc()).limit(500)
        ).all()
        robots = records.scalars(
            sa.select(Robot).where(*visible(Robot)).order_by(Robot.name).limit(500)
        ).all()
        return render(request, "new_session.html", targets=targets, robots=robots, chosen_target=target)


@router.get("/sessions/{session_id}/upload", operation_id="get_session")
def show_upload(request: Request, session_id: str) -> Response:
    """Take images by drag and drop; scripts hash them and send what is missing."""
    service = service_of(request)
    with service.installation.database.read() as records:
        detail = get_session(records, session_id)
        return render(
            request,
            "upload.html",
            **session_context(records, detail, "upload"),
            url=str(request.base_url).rstrip("/"),
            max_bytes=service.installation.settings.max_upload_bytes,
        )
