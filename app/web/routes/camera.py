"""A session's camera: intrinsics with intervals, what the lens model leaves over, coverage, methods compared."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from app.analyses.outcome import AnalysisRefused
from app.web.analyses import analysis_document
from app.web.pages import page_router, render
from app.web.routes.measurements import Row, camera_meaning
from app.web.routes.repeatability import EstimatorText, head_of, settings_of
from app.web.service import service_of
from app.web.words import decimals_of, fixed, number, with_uncertainty

router = page_router()
COVERAGE = 1.96
"""Standard uncertainties of half a 95 % interval."""


@router.get("/sessions/{session_id}/camera", operation_id="get_intrinsics")
async def show_camera(request: Request, session_id: str, estimator: EstimatorText = "pooled") -> Response:
    """Show the camera that all images of each focus group determine."""
    settings = {"estimator": settings_of(estimator, "images")["estimator"]}
    context = await run_in_threadpool(head_of, service_of(request), session_id, "camera")
    found = await analysis_document(request, "intrinsics", session_id, settings)
    is_refused = isinstance(found, AnalysisRefused)
    groups: list[dict[str, Any]] = []
    if not isinstance(found, AnalysisRefused):
        groups = [{**group, "rows": camera_table(group)} for group in found["groups"]]
    return render(
        request,
        "analyses/camera.html",
        **context,
        refused=found if is_refused else None,
        document=None if is_refused else found,
        groups=groups,
        settings={**settings, "source": "images"},
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
        refused=found if is_refused else None,
        document=None if is_refused else found,
    )


def camera_table(group: dict[str, Any]) -> list[Row]:
    """Return a focus group's parameters with standard uncertainty and 95 % interval; those that are held say so."""
    rows = []
    for name, value in {**group["intrinsics"], **group["distortion"]}.items():
        shown, unit = name.removesuffix("_px"), "px" if name.endswith("_px") else ""
        meaning = camera_meaning(name, group["lens_model"])
        uncertainty = group["standard_uncertainty"].get(name)
        decimals = decimals_of(uncertainty)
        if value is None or decimals is None or uncertainty is None:
            rows.append(Row(shown, f"{number(value, 6)} (held)", unit, meaning))
            continue
        low, high = value - COVERAGE * uncertainty, value + COVERAGE * uncertainty
        bounds = f"95 %: [{fixed(low, decimals)}, {fixed(high, decimals)}]"
        rows.append(Row(shown, with_uncertainty(value, uncertainty), unit, f"{meaning}; {bounds}"))
    return rows
