"""A session's repeatability: the ISO table, scatter, drift, steadiness, acceptance, downloads."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any

from fastapi import Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from app.analyses.outcome import AnalysisRefused
from app.services.measured_poses import source_of
from app.services.sessions import get_session
from app.web.analyses import analysis_document, image_names
from app.web.bars import bars_of
from app.web.pages import page_router, render
from app.web.routes.sessions import session_context
from app.web.service import Service, service_of
from app.web.words import ESTIMATORS

router = page_router()
MAX_DRAWN = 40
"""Poses of one plot, as the API draws them."""
EstimatorText = Annotated[str, Query(max_length=40)]
SourceText = Annotated[str, Query(max_length=40)]


@router.get("/sessions/{session_id}/repeatability", operation_id="get_repeatability")
async def show_repeatability(
    request: Request, session_id: str, estimator: EstimatorText = "pooled", source: SourceText = ""
) -> Response:
    """Show every pose's repeatability with its interval, the instrument's floor and a verdict with its reason."""
    own_source = await run_in_threadpool(source_by_itself, service_of(request), session_id)
    settings = settings_of(estimator, source or own_source)
    context = await run_in_threadpool(head_of, service_of(request), session_id, "repeatability")
    found = await analysis_document(request, "repeatability", session_id, settings)
    shown: dict[str, Any] = {"refused": found, "document": None, "rows": [], "bar_end": 0.0, "drawn": False}
    shown |= {"worst_rp": None, "worst_ap": None}
    if not isinstance(found, AnalysisRefused):
        bars, end = bars_of(
            [
                (
                    pose["repeatability"]["rp_l_mm"],
                    pose["interval"]["rp_l_mm"],
                    pose["noise_floor"]["rp_l_mm"],
                    pose["corrected"]["rp_l_mm"] if pose["corrected_interval"]["rp_l_mm"] else None,
                )
                for pose in found["poses"]
            ],
            limit_of(found),
        )
        shown = {
            "refused": None,
            "document": found,
            "rows": list(zip(found["poses"], bars, strict=True)),
            "bar_end": end,
            "drawn": sum(pose["cycles"] > 1 for pose in found["poses"]) <= MAX_DRAWN,
            "worst_rp": largest_of(
                (pose["pose_id"], pose["repeatability"]["rp_l_mm"], pose["interval"]["rp_l_mm"])
                for pose in found["poses"]
            ),
            "worst_ap": largest_of(
                (pose["pose_id"], pose["accuracy"]["ap_p_mm"], pose["accuracy"]["interval"]["ap_p_mm"])
                for pose in found["poses"]
                if pose["accuracy"] is not None
            ),
        }
    return render(
        request,
        "analyses/repeatability.html",
        **context,
        **shown,
        settings=settings,
        image_names=await image_names(request, found),
        own_source=own_source,
        limit=limit_of(found),
    )


@router.get("/sessions/{session_id}/cycles.json", operation_id="get_repeatability")
async def get_cycle_points(
    request: Request, session_id: str, estimator: EstimatorText = "pooled", source: SourceText = ""
) -> Response:
    """Give the cycles' positions about each pose's mean, for the scatter that can be turned."""
    source = await chosen_source(request, session_id, source)
    found = await analysis_document(request, "cycle_points", session_id, settings_of(estimator, source))
    if isinstance(found, AnalysisRefused):
        return JSONResponse({"poses": [], "detail": found.detail, "advice": found.advice})
    return JSONResponse(found, headers={"Cache-Control": "private, no-cache"})


def largest_of(
    figures: Iterable[tuple[str, float | None, Sequence[float] | None]],
) -> dict[str, Any] | None:
    """Return the largest figure with its pose and interval, of (pose, value, interval); None without any."""
    known = [(value, pose_id, interval) for pose_id, value, interval in figures if value is not None]
    if not known:
        return None
    value, pose_id, interval = max(known, key=lambda one: one[0])
    return {"pose_id": pose_id, "value": value, "interval": interval}


def settings_of(estimator: str, source: str) -> dict[str, str]:
    """Return the settings of an analysis; what the API does not know is its default."""
    return {
        "estimator": estimator if estimator in ESTIMATORS else "pooled",
        "source": source if source in ("images", "measured_poses") else "images",
    }


async def chosen_source(request: Request, session_id: str, source: str) -> str:
    """Return the source that was asked for, or without one that of the session by itself."""
    return source or await run_in_threadpool(source_by_itself, service_of(request), session_id)


def source_by_itself(service: Service, session_id: str) -> str:
    """Return where a session's poses are from: another instrument only where there are no images at all."""
    with service.installation.database.read() as records:
        return source_of(records, session_id)


def head_of(service: Service, session_id: str, tab: str) -> dict[str, Any]:
    """Return what the head of a session's page shows."""
    with service.installation.database.read() as records:
        return session_context(records, get_session(records, session_id), tab)


def limit_of(found: dict[str, Any] | AnalysisRefused) -> float | None:
    """Return the data sheet's repeatability, mm, where the robot has one."""
    if isinstance(found, AnalysisRefused) or found["acceptance"] is None:
        return None
    value: float = found["acceptance"]["datasheet_repeatability_mm"]
    return value
