"""What a session says of images not taken yet: the next views of its camera, and repeatability elsewhere."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

import sqlalchemy as sa
from fastapi import Query, Request
from sqlalchemy import orm
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.analyses.outcome import AnalysisRefused
from app.errors import NotAllowed
from app.http import holds
from app.records.tables import Target
from app.services.queries import visible
from app.services.robots import read_limits
from app.web.analyses import analysis_document
from app.web.pages import is_fragment, page_router, render
from app.web.routes.repeatability import SourceText, head_of, settings_of
from app.web.service import Service, service_of

router = page_router()
VIEWS = 3
NextViewPurpose = Literal["intrinsics", "hand_eye", "dh"]


def require_computing(request: Request) -> None:
    """Raise NotAllowed for a key that only reads: what these pages compute, the API computes for `upload`."""
    if not holds(request, "upload"):
        raise NotAllowed("Your key only reads; this needs upload.", "Sign in with a key of scope upload.")


def known_targets(records: orm.Session) -> list[Target]:
    """Return the targets there are, newest first; 500 at most."""
    found = sa.select(Target).where(*visible(Target)).order_by(Target.id.desc()).limit(500)
    return list(records.scalars(found))


@router.get("/sessions/{session_id}/next-view", operation_id="create_next_view")
async def show_next_views(
    request: Request,
    session_id: str,
    purpose: NextViewPurpose = "intrinsics",
    focus_group: Annotated[str, Query(max_length=200)] = "",
) -> Response:
    """Show the views that would make camera, mount or robot most certain, and what each would gain."""
    require_computing(request)
    settings = {"purpose": purpose, "count": str(VIEWS)}
    settings |= {"focus_group": focus_group} if focus_group else {}
    tab = "robot" if purpose == "dh" else "camera"
    return await _show(request, session_id, tab, "next_view", settings, "_next_view.html")


@router.get("/sessions/{session_id}/joint-noise", operation_id="get_joint_noise")
async def show_joint_noise(request: Request, session_id: str, source: SourceText = "images") -> Response:
    """Show the noise of the robot's joints, and RP_l predicted by it over the workspace."""
    chosen = settings_of("", source)
    limits = await run_in_threadpool(_limits, service_of(request), session_id)
    settings = {**chosen, "limits": limits}
    return await _show(request, session_id, "robot", "joint_noise", settings, "_joint_noise.html")


async def _show(
    request: Request, session_id: str, tab: str, analysis: str, settings: dict[str, str], part: str
) -> Response:
    context = await run_in_threadpool(head_of, service_of(request), session_id, tab)
    found = await analysis_document(request, analysis, session_id, settings)
    is_refused = isinstance(found, AnalysisRefused)
    shown: dict[str, Any] = {
        "part": part,
        "settings": settings,
        "refused": found if is_refused else None,
        "document": None if is_refused else found,
    }
    return render(request, part if is_fragment(request) else "advice.html", **context, **shown)


def _limits(service: Service, session_id: str) -> str:
    with service.installation.database.read() as records:
        return json.dumps(read_limits(records, session_id))
