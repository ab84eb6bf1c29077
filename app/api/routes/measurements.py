"""/v1/measurements: what came of images"""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Query, Request, Response
from fastapi.responses import FileResponse
from pydantic import Field

from app.api.dependencies import AppContextDep, Cursor, Limit, MeasurementPath, SessionPath
from app.api.json_body import json_answer
from app.api.representations import (
    ETAG_HEADER,
    AcceptHeader,
    KnownTags,
    answer_drawing,
    binary_content,
    draw_overlay,
    preferred_media_type,
    stated_media_type,
)
from app.api.responses import OpenFileResponse, measurement_document
from app.api.routing import api_router, problem_responses
from app.api.schemas.common import PlainDigits, PoseTag
from app.api.schemas.measurements import (
    MeasurementChange,
    MeasurementPage,
    MeasurementRead,
    MeasurementStatus,
)
from app.http import RequesterDep
from app.services import measurements

router = api_router(prefix="/v1", tags=["measurements"])
DEFAULT_WIDTH = 1200
WidthQuery = Annotated[
    int,
    Field(ge=160, le=2400),
    PlainDigits,
    Query(
        description="Width of the drawing in pixels. Text and marks are sized by it, not by the original.",
    ),
]
MEDIA_TYPES = {"png": "image/png", "jpeg": "image/jpeg", "tiff": "image/tiff", "bmp": "image/bmp"}


@router.get(
    "/sessions/{session_id}/measurements",
    response_model=MeasurementPage,
    responses=problem_responses(404),
)
def list_measurements(
    session_id: SessionPath,
    service: AppContextDep,
    status: Annotated[
        MeasurementStatus | None, Query(description="Measurements of this status alone.")
    ] = None,
    pose_id: Annotated[
        PoseTag | None, Query(description="Measurements of this pose alone, by the user's tag.")
    ] = None,
    limit: Limit = 50,
    cursor: Cursor = None,
) -> Response:
    """List a session's measurements, oldest first."""
    with service.installation.database.read() as records:
        views, next_cursor = measurements.list_measurements(
            records, session_id, status=status, pose_id=pose_id, limit=limit, cursor=cursor
        )
    items = [measurement_document(view) for view in views]
    return json_answer(MeasurementPage(items=items, next_cursor=next_cursor, warnings=[]))


@router.get("/measurements/{measurement_id}", responses=problem_responses(404, 409))
def get_measurement(
    measurement_id: MeasurementPath,
    service: AppContextDep,
    include: Annotated[
        Literal["points"] | None,
        Query(description="`points`: with every grid point; otherwise `points` is null."),
    ] = None,
) -> MeasurementRead:
    """Return one measurement."""
    with service.installation.database.read() as records:
        view = measurements.get_measurement(records, measurement_id)
        points = measurements.get_points(records, measurement_id) if include == "points" else None
    return measurement_document(view, points)


@router.patch("/measurements/{measurement_id}", responses=problem_responses(404, 409, 413, 415, 507))
def update_measurement(
    measurement_id: MeasurementPath, body: MeasurementChange, service: AppContextDep
) -> MeasurementRead:
    """Correct what was said about an image, or exclude a measurement from analyses.

    Pose, cycle, burst index, focus group and joint angles change in all measurements of the image; `excluded` in this
    one. Where the image is at the new pose already with one of its targets, 409 `image_already_at_pose`; a burst index
    that would be left without a cycle, 422 `burst_without_cycle`.
    """
    changes = body.model_dump(exclude_unset=True)
    if body.excluded is not None:
        changes["excluded"] = body.excluded.reason
    with service.installation.database.write() as records:
        return measurement_document(measurements.correct_measurement(records, measurement_id, changes))


@router.delete(
    "/measurements/{measurement_id}",
    status_code=204,
    response_class=Response,
    responses=problem_responses(404, 507),
)
def delete_measurement(measurement_id: MeasurementPath, service: AppContextDep) -> None:
    """Delete a measurement with its result, and its original unless another measurement holds it.

    To keep the record, exclude it instead (`PATCH`): an image that is gone is sent again by a repeated upload.
    """
    measurements.delete_measurement(service.installation, measurement_id)


@router.get(
    "/measurements/{measurement_id}/image",
    response_class=FileResponse,
    responses={
        200: {
            "description": "The original, byte for byte.",
            "content": binary_content(*MEDIA_TYPES.values()),
        },
        **problem_responses(404, 409),
    },
)
def get_image(measurement_id: MeasurementPath, service: AppContextDep, request: Request) -> OpenFileResponse:
    """Return the original image as a file to save, once its bytes were found to be those uploaded."""
    measurement, file = measurements.open_image(service.installation, measurement_id)
    return OpenFileResponse(
        file,
        media_type=stated_media_type(request.headers.get("accept"), MEDIA_TYPES[measurement.image_format]),
        filename=measurement.filename or f"{measurement.sha256}.{measurement.image_format}",
    )


@router.get(
    "/measurements/{measurement_id}/overlay",
    response_class=Response,
    responses={
        200: {
            "description": "The image with what was seen in it. Below it: the verdict, the reason and the advice, and "
            "what the marks mean.",
            "content": binary_content("image/png", "image/webp"),
            "headers": ETAG_HEADER,
        },
        304: {"description": "The client has this drawing already.", "headers": ETAG_HEADER},
        **problem_responses(404, 409),
    },
)
def get_overlay(
    measurement_id: MeasurementPath,
    service: AppContextDep,
    requester: RequesterDep,
    width: WidthQuery = DEFAULT_WIDTH,
    accept: AcceptHeader = None,
    known: KnownTags = None,
) -> Response:
    """Draw what was found into the image, whatever came of it.

    Grid points with their residuals, rejected points, the target's axes; of an image without a target the candidates
    for its grid points. WebP where `Accept` prefers it, else PNG.
    """
    media_type = preferred_media_type(accept)
    drawn = draw_overlay(service, measurement_id, width, media_type, requester)
    return answer_drawing(drawn, stated_media_type(accept, media_type), known)


@router.get(
    "/measurements/{measurement_id}/thumbnail",
    response_class=Response,
    responses={
        200: {
            "description": "The image in grey, at most 320 pixels along its longer side.",
            "content": binary_content("image/webp"),
        },
        **problem_responses(404, 409),
    },
)
async def get_thumbnail(
    measurement_id: MeasurementPath, service: AppContextDep, requester: RequesterDep, request: Request
) -> Response:
    """Return a small image for lists; it never changes, so that clients may keep it."""
    drawn = await measurements.get_thumbnail(service.installation, service.painter, measurement_id, requester)
    headers = {"Vary": "Accept", "Cache-Control": "private, max-age=31536000, immutable"}
    media_type = stated_media_type(request.headers.get("accept"), "image/webp")
    return Response(drawn, media_type=media_type, headers=headers)


@router.post(
    "/measurements/{measurement_id}/retry", status_code=202, responses=problem_responses(404, 409, 507)
)
def retry_measurement(
    measurement_id: MeasurementPath, service: AppContextDep, response: Response
) -> MeasurementRead:
    """Compute a measurement again with today's code, whatever came of it before.

    The result it has stays, and is used by analyses, until the new one replaces it. Where the retry computes nothing
    (`worker_crashed`, `processing_timeout`, `original_corrupt`, ...) a result with grid points stays for good, and
    `retry_failure` says why.
    """
    view = measurements.retry_measurement(service.installation, measurement_id)
    response.headers["Location"] = f"/v1/measurements/{measurement_id}"
    return measurement_document(view)
