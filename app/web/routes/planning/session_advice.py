"""What a session says of images not taken yet: the next views of its camera, and repeatability elsewhere."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal
from urllib.parse import parse_qsl, urlsplit

import sqlalchemy as sa
from fastapi import Query, Request
from sqlalchemy import orm
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.analyses.outcome import AnalysisRefused
from app.analyses.reporting import DH_DEFAULTS
from app.errors import NotAllowed
from app.http import holds
from app.records.tables import Measurement, Target
from app.services.queries import visible
from app.services.robots import limits_setting
from app.web.analyses import analysis_document, image_names
from app.web.pages import is_fragment, page_router, render
from app.web.routes.repeatability import SourceText, chosen_source, head_of, settings_of
from app.web.service import Service, service_of

router = page_router()
VIEWS = 3
MAX_GROUPS = 100
MIN_GAIN = 0.05
"""Share by which a suggested view makes an uncertainty smaller at least."""
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
    limits = await run_in_threadpool(limits_setting, service_of(request).installation.database, session_id)
    settings = {"purpose": purpose, "count": str(VIEWS), "limits": limits}
    settings |= {"focus_group": focus_group} if focus_group else {}
    tab = "robot" if purpose == "dh" else "camera"
    groups = await run_in_threadpool(focus_groups, service_of(request), session_id)
    return await _show(
        request,
        session_id,
        tab,
        "next_view",
        settings,
        "planning/_next_view.html",
        focus_groups=groups if purpose == "intrinsics" and len(groups) > 1 else [],
    )


def focus_groups(service: Service, session_id: str) -> list[str]:
    """Return the focus groups of a session's images, by name."""
    with service.installation.database.read() as records:
        found = sa.select(Measurement.focus_group).where(Measurement.session_id == session_id).distinct()
        return sorted(records.scalars(found.limit(MAX_GROUPS)))


@router.get("/sessions/{session_id}/joint-noise", operation_id="get_joint_noise")
async def show_joint_noise(request: Request, session_id: str, source: SourceText = "") -> Response:
    """Show the noise of the robot's joints, and RP_l predicted by it over the workspace."""
    return await _show_map(request, session_id, source, "joint_noise", "planning/_joint_noise.html")


@router.get("/sessions/{session_id}/error-map", operation_id="get_error_map")
async def show_error_map(request: Request, session_id: str, source: SourceText = "") -> Response:
    """Show how far the robot is from where its data sheet puts it, over the workspace."""
    return await _show_map(request, session_id, source, "kinematic_error", "planning/_error_map.html")


async def _show_map(request: Request, session_id: str, source: str, analysis: str, part: str) -> Response:
    database = service_of(request).installation.database
    limits = await run_in_threadpool(limits_setting, database, session_id)
    chosen = await chosen_source(request, session_id, source)
    settings = {**settings_of("", chosen), "limits": limits}
    return await _show(request, session_id, "robot", analysis, settings, part)


def views_of(suggestions: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the suggested views up to the first that gains little; `repeats` is the number of an earlier same one."""
    views: list[dict[str, Any]] = []
    for one in suggestions:
        now, then = one["expected_uncertainty_now"], one["expected_uncertainty_after"]
        if not any(value and then[name] < (1.0 - MIN_GAIN) * value for name, value in now.items()):
            break
        same = (
            number
            for number, view in enumerate(views, 1)
            if view["T_target_camera"] == one["T_target_camera"]
        )
        views.append({**one, "repeats": next(same, None)})
    return views


async def _show(
    request: Request,
    session_id: str,
    tab: str,
    analysis: str,
    settings: dict[str, str],
    part: str,
    **more: Any,
) -> Response:
    context = await run_in_threadpool(head_of, service_of(request), session_id, tab)
    found = await analysis_document(request, analysis, session_id, settings)
    is_refused = isinstance(found, AnalysisRefused)
    if not isinstance(found, AnalysisRefused) and is_fragment(request):
        known = await run_in_threadpool(
            _warnings_of_page, request, session_id, settings.get("source", "images")
        )
        found["warnings"] = [one for one in found["warnings"] if (one["code"], one["detail"]) not in known]
    shown: dict[str, Any] = {
        "part": part,
        "settings": settings,
        "image_names": await image_names(request, found),
        "refused": found if is_refused else None,
        "document": None if is_refused else found,
        "views": [] if isinstance(found, AnalysisRefused) else views_of(found.get("suggestions", [])),
    }
    return render(
        request, part if is_fragment(request) else "planning/advice.html", **context, **shown, **more
    )


def _warnings_of_page(request: Request, session_id: str, source: str) -> set[tuple[str, str]]:
    """Return code and text of the warnings of the page that a part is put into: the robot's or the camera's."""
    page = urlsplit(request.headers.get("hx-current-url", ""))
    asked = dict(parse_qsl(page.query))
    if page.path == f"/ui/sessions/{session_id}/robot":
        question = "dh", {**DH_DEFAULTS, "source": source}
    elif page.path == f"/ui/sessions/{session_id}/camera":
        question = "intrinsics", {"estimator": settings_of(asked.get("estimator", ""), "")["estimator"]}
    else:
        return set()
    kept = service_of(request).analyses.kept(question[0], session_id, question[1])
    if kept is None or isinstance(kept, AnalysisRefused):
        return set()
    return {(one["code"], one["detail"]) for one in json.loads(kept)["warnings"]}
