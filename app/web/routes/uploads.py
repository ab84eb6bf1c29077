"""A new session, a change of one, and adding images to it."""

from __future__ import annotations

from typing import Annotated

import sqlalchemy as sa
from fastapi import Query, Request
from sqlalchemy import orm
from starlette.responses import Response

from app.records.tables import Robot
from app.services.queries import visible
from app.services.sessions import get_session
from app.web.pages import page_router, render
from app.web.routes.planning.session_advice import known_targets
from app.web.routes.sessions import session_context
from app.web.service import service_of

router = page_router()


@router.get("/sessions/new", operation_id="list_sessions")
def show_new_session(request: Request, target: Annotated[str, Query(max_length=64)] = "") -> Response:
    """Ask for a session's target, robot and conditions."""
    with service_of(request).installation.database.read() as records:
        return render(
            request,
            "new_session.html",
            targets=known_targets(records),
            robots=_robots(records),
            chosen_target=target,
        )


@router.get("/sessions/{session_id}/change", operation_id="update_session")
def show_change(request: Request, session_id: str) -> Response:
    """Ask for another name, target or robot of a session."""
    with service_of(request).installation.database.read() as records:
        return render(
            request,
            "session_change.html",
            **session_context(records, get_session(records, session_id), "change"),
            known_targets=known_targets(records),
            robots=_robots(records),
        )


def _robots(records: orm.Session) -> list[Robot]:
    found = sa.select(Robot).where(*visible(Robot)).order_by(Robot.name).limit(500)
    return list(records.scalars(found))


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
