"""A session's camera: intrinsics with intervals, what the lens model leaves over, coverage, methods compared."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.analyses.outcome import AnalysisRefused
from app.web.analyses import analysis_document, image_names
from app.web.pages import page_router, render
from app.web.routes.measurements import camera_rows
from app.web.routes.repeatability import EstimatorText, head_of, settings_of
from app.web.service import service_of

router = page_router()


@router.get("/sessions/{session_id}/camera", operation_id="get_intrinsics")
async def show_camera(request: Request, session_id: str, estimator: EstimatorText = "pooled") -> Response:
    """Show the camera that all images of each focus group determine."""
    settings = {"estimator": settings_of(estimator, "images")["estimator"]}
    context = await run_in_threadpool(head_of, service_of(request), session_id, "camera")
    found = await analysis_document(request, "intrinsics", session_id, settings)
    is_refused = isinstance(found, AnalysisRefused)
    groups: list[dict[str, Any]] = []
    if not isinstance(found, AnalysisRefused):
        groups = [{**group, "rows": camera_rows(group, group["lens_model"])} for group in found["groups"]]
    return render(
        request,
        "analyses/camera.html",
        **context,
        refused=found if is_refused else None,
        document=None if is_refused else found,
        groups=groups,
        settings={**settings, "source": "images"},
        image_names=await image_names(request, found),
    )


@router.get("/sessions/{session_id}/comparison", operation_id="get_comparison")
async def show_comparison(
    request: Request, session_id: str, part: Annotated[str, Query(max_length=16)] = ""
) -> Response:
    """Show the published methods alongside ours on the same images: Tables II and III."""
    context = await run_in_threadpool(head_of, service_of(request), session_id, "camera")
    found = await analysis_document(request, "comparison", session_id, {})
    is_refused = isinstance(found, AnalysisRefused)
    return render(
        request,
        "analyses/comparison.html",
        **context,
        image_names=await image_names(request, found),
        refused=found if is_refused else None,
        document=None if is_refused else found,
    )
