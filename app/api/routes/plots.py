"""/v1/sessions/{session_id}: analyses as plots"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from app.api.dependencies import AppContext, SessionPath, get_app_context
from app.api.representations import KnownTags, answer_analysis, binary_content, stated_media_type
from app.api.routes.analyses import ETAG_HEADER, EstimatorQuery, SourceQuery
from app.api.routing import api_router, problem_responses
from app.api.schemas.common import Text
from app.services import poses
from app.services.queries import POSE_ID

SVG = "image/svg+xml"
_CONTENT = {SVG: {"schema": {"type": "string"}}, **binary_content()}

router = api_router(prefix="/v1/sessions/{session_id}", tags=["analyses"])

PoseQuery = Annotated[
    str | None, Query(pattern=POSE_ID, description="This pose alone; all of them by default, 40 at most.")
]
FocusGroupQuery = Annotated[
    Text | None, Query(description="This focus group alone; all of them by default, 40 at most.")
]


@dataclass
class PosePlot:
    """What a plot of poses shows, by the query."""

    pose_id: PoseQuery = None
    estimator: EstimatorQuery = "pooled"
    source: SourceQuery = "images"


PosePlotDep = Annotated[PosePlot, Depends()]


def _responses(shown: str) -> dict[int | str, dict[str, Any]]:
    return {
        200: {"description": shown, "content": _CONTENT, "headers": ETAG_HEADER},
        304: {"description": "The client has this plot already.", "headers": ETAG_HEADER},
        **problem_responses(404, 409, 422, 503),
    }


@router.get(
    "/repeatability/scatter.svg",
    response_class=Response,
    responses=_responses(
        "For every pose its cycles about their mean in three projections, with the ellipsoid observed and that of the "
        "instrument's noise."
    ),
)
async def get_scatter_plot(
    session_id: SessionPath, request: Request, chosen: PosePlotDep, known: KnownTags = None
) -> Response:
    """Draw how the positions of each pose scatter, and how much of that is the instrument's."""
    return await _answer_for_poses(request, "scatter_plot", session_id, chosen, known)


@router.get(
    "/repeatability/drift.svg",
    response_class=Response,
    responses=_responses(
        "For every pose x, y and z over the cycles, with the means of blocks of ten cycles."
    ),
)
async def get_drift_plot(
    session_id: SessionPath, request: Request, chosen: PosePlotDep, known: KnownTags = None
) -> Response:
    """Draw how the poses move over the cycles."""
    return await _answer_for_poses(request, "drift_plot", session_id, chosen, known)


@router.get(
    "/repeatability/steadiness.svg",
    response_class=Response,
    responses=_responses(
        "The motion that all poses share over the cycles, and each pose's own, with trend and largest step where they "
        "are significant, and second stopping points."
    ),
)
async def get_steadiness_plot(
    session_id: SessionPath, request: Request, chosen: PosePlotDep, known: KnownTags = None
) -> Response:
    """Draw whether the cycles are steady, and what moved; all poses are tested whichever is drawn."""
    return await _answer_for_poses(request, "steadiness_plot", session_id, chosen, known)


@router.get(
    "/intrinsics/residuals.svg",
    response_class=Response,
    responses=_responses("For every focus group the mean residuals over the image, and the residuals' size."),
)
async def get_residual_map(
    session_id: SessionPath,
    request: Request,
    estimator: EstimatorQuery = "pooled",
    focus_group: FocusGroupQuery = None,
    known: KnownTags = None,
) -> Response:
    """Draw what the camera model leaves over, by place in the image."""
    settings: dict[str, str] = {"estimator": estimator}
    if focus_group is not None:
        settings["focus_group"] = focus_group
    return await _answer(request, "residual_map", session_id, settings, known)


async def _answer_for_poses(
    request: Request, analysis: str, session_id: str, chosen: PosePlot, known: str | None
) -> Response:
    settings: dict[str, str] = {"estimator": chosen.estimator, "source": chosen.source}
    if chosen.pose_id is not None:
        settings["pose_id"] = chosen.pose_id
        await run_in_threadpool(_check_pose, await get_app_context(request), session_id, chosen.pose_id)
    return await _answer(request, analysis, session_id, settings, known)


async def _answer(
    request: Request, analysis: str, session_id: str, settings: dict[str, str], known: str | None
) -> Response:
    media_type = stated_media_type(request.headers.get("accept"), SVG)
    return await answer_analysis(request, analysis, session_id, settings, known, media_type=media_type)


def _check_pose(service: AppContext, session_id: str, pose_id: str) -> None:
    with service.installation.database.read() as records:
        poses.get_pose(records, session_id, pose_id)
