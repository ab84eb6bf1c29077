"""/v1/sessions/{session_id}: analyses as pictures"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import Query, Response

from app.api.contract import Service, ServiceDep, contract_router, problems
from app.api.routes.analyses import ETAG_HEADER, EstimatorQuery, KnownTags, SourceQuery, answer_analysis
from app.api.schemas.common import Text
from app.services import poses
from app.services.lookup import POSE_ID

SVG = "image/svg+xml"

router = contract_router(prefix="/v1/sessions/{session_id}", tags=["analyses"])

PoseQuery = Annotated[
    str | None, Query(pattern=POSE_ID, description="This pose alone; all of them by default, 40 at most.")
]
FocusGroupQuery = Annotated[
    Text | None, Query(description="This focus group alone; all of them by default, 40 at most.")
]


def _responses(shown: str) -> dict[int | str, dict[str, Any]]:
    return {
        200: {"description": shown, "content": {SVG: {"schema": {"type": "string"}}}, "headers": ETAG_HEADER},
        304: {"description": "The client has this picture already.", "headers": ETAG_HEADER},
        **problems(404, 409, 422, 503),
    }


@router.get(
    "/repeatability/scatter.svg",
    response_class=Response,
    responses=_responses(
        "For every pose its cycles about their mean in three projections, with the ellipsoid observed and that of the "
        "instrument's noise."
    ),
)
def get_scatter_plot(
    session_id: str,
    service: ServiceDep,
    pose_id: PoseQuery = None,
    estimator: EstimatorQuery = "pooled",
    source: SourceQuery = "images",
    known: KnownTags = None,
) -> Response:
    """Draw how the positions of each pose scatter, and how much of that is the instrument's."""
    settings = {"estimator": estimator, "source": source}
    return _answer(service, "scatter_plot", session_id, settings, {"pose_id": pose_id}, known)


@router.get(
    "/repeatability/drift.svg",
    response_class=Response,
    responses=_responses(
        "For every pose x, y and z over the cycles, with the means of blocks of ten cycles."
    ),
)
def get_drift_plot(
    session_id: str,
    service: ServiceDep,
    pose_id: PoseQuery = None,
    estimator: EstimatorQuery = "pooled",
    source: SourceQuery = "images",
    known: KnownTags = None,
) -> Response:
    """Draw how the poses move over the cycles."""
    settings = {"estimator": estimator, "source": source}
    return _answer(service, "drift_plot", session_id, settings, {"pose_id": pose_id}, known)


@router.get(
    "/intrinsics/residuals.svg",
    response_class=Response,
    responses=_responses("For every focus group the mean residuals over the image, and the residuals' size."),
)
def get_residual_map(
    session_id: str,
    service: ServiceDep,
    estimator: EstimatorQuery = "pooled",
    focus_group: FocusGroupQuery = None,
    known: KnownTags = None,
) -> Response:
    """Draw what the camera model leaves over, by place in the image."""
    settings = {"estimator": estimator}
    return _answer(service, "residual_map", session_id, settings, {"focus_group": focus_group}, known)


def _answer(
    service: Service,
    analysis: str,
    session_id: str,
    settings: Mapping[str, str],
    chosen: Mapping[str, str | None],
    known: str | None,
) -> Response:
    pose_id = chosen.get("pose_id")
    if pose_id is not None:
        with service.installation.database.read() as records:
            poses.get_pose(records, session_id, pose_id)
    settings = {**settings, **{name: value for name, value in chosen.items() if value is not None}}
    return answer_analysis(service, analysis, session_id, settings, known, media_type=SVG)
