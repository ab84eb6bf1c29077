"""/v1/sessions/{session_id}: what the stored measurements amount to"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Header, Query, Response

from app.api.contract import Service, ServiceDep, contract_router, problems
from app.api.schemas.analyses import Estimator, IntrinsicsAnalysis, RepeatabilityAnalysis, Source
from app.api.schemas.comparison import ComparisonAnalysis

CONFIDENCE_LEVEL = "0.95"

router = contract_router(prefix="/v1/sessions/{session_id}", tags=["analyses"])

ETAG_HEADER = {
    "ETag": {"description": "Changes with what the answer is computed from.", "schema": {"type": "string"}}
}
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"headers": ETAG_HEADER},
    304: {"description": "The client has this answer already.", "headers": ETAG_HEADER},
    **problems(404, 409, 422, 503),
}
EstimatorQuery = Annotated[
    Estimator,
    Query(
        description="`pooled`: one camera for all images of a focus group. `pooled_free_focal`: the same with a focal "
        "length for each image. `per_image`: every image by itself. `per_image_fixed_pp`: the same with the principal "
        "point held. `given`: the session's intrinsics."
    ),
]
SourceQuery = Annotated[
    Source,
    Query(
        description="`images`: poses estimated from images. `measured_poses`: those another instrument measured."
    ),
]
RefineQuery = Annotated[
    bool,
    Query(
        description="Estimate the target's own shape, too (print errors, bow), and the camera before the target as it "
        "is; takes images that show it from eight directions or more."
    ),
]
KnownTags = Annotated[
    str | None,
    Header(alias="If-None-Match", max_length=4096, description="Entity tags of answers the client has."),
]


@router.get("/intrinsics", response_model=IntrinsicsAnalysis, responses=_RESPONSES)
def get_intrinsics(
    session_id: str,
    service: ServiceDep,
    estimator: EstimatorQuery = "pooled",
    refine_target: RefineQuery = False,
    known: KnownTags = None,
) -> Response:
    """Calibrate the session's camera from all its images, repeated poses or not."""
    settings = {"estimator": estimator} | ({"refine_target": "true"} if refine_target else {})
    return answer_analysis(service, "intrinsics", session_id, settings, known)


@router.get("/repeatability", response_model=RepeatabilityAnalysis, responses=_RESPONSES)
def get_repeatability(
    session_id: str,
    service: ServiceDep,
    estimator: EstimatorQuery = "pooled",
    source: SourceQuery = "images",
    known: KnownTags = None,
) -> Response:
    """Give every pose's repeatability by ISO 9283, with intervals, noise floor, verdict and accuracy."""
    settings = {"estimator": estimator, "source": source, "confidence_level": CONFIDENCE_LEVEL}
    return answer_analysis(service, "repeatability", session_id, settings, known)


@router.get("/comparison", response_model=ComparisonAnalysis, responses=_RESPONSES)
def get_comparison(session_id: str, service: ServiceDep, known: KnownTags = None) -> Response:
    """Compare every method on the same images: calibration (the paper's Table II) and repeatability (Table III)."""
    return answer_analysis(service, "comparison", session_id, {}, known)


def answer_analysis(
    service: Service,
    analysis: str,
    session_id: str,
    settings: dict[str, str],
    known: str | None,
    media_type: str = "application/json",
) -> Response:
    """Answer with a document of the analysis desk, or that the client has it."""
    answer = service.analyses.answer(
        service.installation, analysis, session_id, settings, _entity_tags(known)
    )
    headers = {"ETag": answer.etag, "Cache-Control": "private, no-cache"}
    if answer.body is None:
        return Response(status_code=304, headers=headers)
    return Response(answer.body, media_type=media_type, headers=headers)


def _entity_tags(known: str | None) -> frozenset[str]:
    """Return the tags of an If-None-Match header; weak ones compare as strong ones do (RFC 9110, 13.1.2)."""
    if known is None:
        return frozenset()
    return frozenset(tag.strip().removeprefix("W/") for tag in known.split(","))
