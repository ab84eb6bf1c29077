"""Images in, measurements out."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import Path, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.concurrency import run_in_threadpool

from app.api.contract import Cursor, Limit, Service, ServiceDep, contract_router, problems
from app.api.files import WholeFile
from app.api.problems import invalid_request
from app.api.schemas.common import Cycle, Identifier, Moment, PoseTag, Sha256, Text, parse_joint_angles
from app.api.schemas.measurements import (
    ImageList,
    MeasurementPage,
    MeasurementRead,
    MeasurementStatus,
    MissingImages,
)
from app.api.uploads import receive_form, receive_raw, require_image_type
from app.api.views import measurement_document, quality_document
from app.errors import Conflict, InvalidContent
from app.records.tables import Session
from app.services import measurements
from app.services.lookup import find

router = contract_router(prefix="/v1", tags=["measurements"])

MEDIA_TYPES = {"png": "image/png", "jpeg": "image/jpeg", "tiff": "image/tiff", "bmp": "image/bmp"}
_ACCEPTED: dict[int | str, dict[str, Any]] = {
    200: {"model": MeasurementRead, "description": "The same image is here already: the first measurement."},
    **problems(404, 413, 415, 422, 507),
}
_RAW_BODY = {
    "requestBody": {
        "required": True,
        "content": {
            media_type: {"schema": {"type": "string", "format": "binary"}}
            for media_type in ("application/octet-stream", "image/*")
        },
    }
}
_TARGET = (
    "What the image shows; by default the session's only target. Where it has several, the image is searched for all "
    "of them, and each that it shows becomes a measurement."
)
_ANGLES = "Comma-separated joint angles, degrees; they override the pose's."
JointList = Annotated[str, Field(min_length=1, max_length=400)]


class ImageForm(BaseModel):
    """The text fields beside the file of a multipart upload."""

    model_config = ConfigDict(extra="forbid")

    pose_id: PoseTag
    cycle: Cycle | None = None
    target_id: Identifier | None = None
    focus_group: Text = "default"
    joint_angles_deg: JointList | None = None
    captured_at: Moment | None = None


_FORM_BODY = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": {
                    "type": "object",
                    "required": ["image", "pose_id"],
                    "additionalProperties": False,
                    "properties": {
                        "image": {"type": "string", "format": "binary"},
                        "pose_id": {
                            "type": "string",
                            "minLength": 1,
                            "maxLength": 128,
                            "pattern": "^[A-Za-z0-9_-][A-Za-z0-9._-]*$",
                        },
                        "cycle": {"type": "integer", "minimum": 1, "maximum": 2**31 - 1},
                        "target_id": {"type": "string", "description": _TARGET},
                        "focus_group": {"type": "string", "minLength": 1, "maxLength": 200},
                        "joint_angles_deg": {"type": "string", "description": _ANGLES},
                        "captured_at": {"type": "string", "format": "date-time"},
                    },
                }
            }
        },
    }
}


@router.put(
    "/sessions/{session_id}/poses/{pose_id}/images/{sha256}",
    status_code=202,
    responses=_ACCEPTED,
    openapi_extra=_RAW_BODY,
)
async def put_image(
    request: Request,
    session_id: str,
    pose_id: PoseTag,
    sha256: Annotated[Sha256, Path(description="SHA-256 of the body, 64 hex digits.")],
    service: ServiceDep,
    response: Response,
    cycle: Cycle | None = None,
    target_id: Annotated[Identifier | None, Query(description=_TARGET)] = None,
    focus_group: Text = "default",
    joint_angles_deg: Annotated[JointList | None, Query(description=_ANGLES)] = None,
    captured_at: Moment | None = None,
    filename: Annotated[str | None, Query(max_length=1000)] = None,
) -> MeasurementRead:
    """Send one image of a pose, as it is, under its hash; safe to repeat for ever."""
    metadata = measurements.Metadata(
        cycle=cycle,
        target_id=target_id,
        focus_group=focus_group,
        joint_angles_deg=_joint_angles(joint_angles_deg),
        captured_at=captured_at,
        filename=filename,
    )
    require_image_type(request)
    intended = await run_in_threadpool(_check_target, service, session_id, target_id)
    _refuse_unknown(request)
    async with receive_raw(request, service.installation) as staged:
        accepted = await run_in_threadpool(
            measurements.accept_image,
            service.installation,
            session_id,
            pose_id,
            staged,
            metadata,
            expected_sha256=sha256,
            intended=intended,
        )
    return _answer(response, accepted)


@router.post("/sessions/{session_id}/images", status_code=202, responses=_ACCEPTED, openapi_extra=_FORM_BODY)
async def create_image(
    request: Request, session_id: str, service: ServiceDep, response: Response
) -> MeasurementRead:
    """Send one image as a multipart form."""
    async with receive_form(request, service.installation) as (staged, form):
        try:
            fields = ImageForm.model_validate(form.fields)
        except ValidationError as error:
            raise invalid_request(error.errors()) from None
        metadata = measurements.Metadata(
            cycle=fields.cycle,
            target_id=fields.target_id,
            focus_group=fields.focus_group,
            joint_angles_deg=_joint_angles(fields.joint_angles_deg),
            captured_at=fields.captured_at,
            filename=form.filename,
        )
        accepted = await run_in_threadpool(
            measurements.accept_image,
            service.installation,
            session_id,
            fields.pose_id,
            staged,
            metadata,
            expected_sha256=None,
        )
    return _answer(response, accepted)


@router.post("/sessions/{session_id}/images/missing", tags=["bulk"], responses=problems(404, 413, 415, 422))
def find_missing_images(session_id: str, body: ImageList, service: ServiceDep) -> MissingImages:
    """Tell which of these images are not here yet."""
    with service.installation.database.read() as records:
        missing = measurements.find_missing(
            records,
            service.installation.blobs,
            session_id,
            [(image.pose_id, image.sha256) for image in body.images],
        )
    return MissingImages.model_validate(
        {"missing": [{"pose_id": pose_id, "sha256": sha256} for pose_id, sha256 in missing]}
    )


@router.get("/sessions/{session_id}/measurements", responses=problems(404, 422))
def list_measurements(
    session_id: str,
    service: ServiceDep,
    status: MeasurementStatus | None = None,
    pose_id: PoseTag | None = None,
    limit: Limit = 50,
    cursor: Cursor = None,
) -> MeasurementPage:
    """List a session's measurements, oldest first."""
    with service.installation.database.read() as records:
        views, next_cursor = measurements.list_measurements(
            records, session_id, status=status, pose_id=pose_id, limit=limit, cursor=cursor
        )
    return MeasurementPage(items=[measurement_document(view) for view in views], next_cursor=next_cursor)


@router.get("/measurements/{measurement_id}", responses=problems(404, 422))
def get_measurement(
    measurement_id: str,
    service: ServiceDep,
    include: Annotated[Literal["points"] | None, Query(description="`points`: every grid point too.")] = None,
) -> MeasurementRead:
    """Return one measurement."""
    with service.installation.database.read() as records:
        view = measurements.get_measurement(records, measurement_id)
        points = measurements.get_points(records, measurement_id) if include == "points" else None
    return measurement_document(view, points)


@router.get(
    "/measurements/{measurement_id}/image",
    response_class=WholeFile,
    responses={
        200: {
            "description": "The original, byte for byte.",
            "content": {
                media_type: {"schema": {"type": "string", "format": "binary"}}
                for media_type in MEDIA_TYPES.values()
            },
        },
        **problems(404),
    },
)
def get_image(measurement_id: str, service: ServiceDep) -> WholeFile:
    """Return the original image as a file to save."""
    measurement, path = measurements.get_original(service.installation, measurement_id)
    return WholeFile(
        path,
        media_type=MEDIA_TYPES[measurement.image_format],
        filename=measurement.filename or f"{measurement.sha256}.{measurement.image_format}",
        content_disposition_type="attachment",
    )


@router.get(
    "/measurements/{measurement_id}/overlay",
    response_class=Response,
    responses={
        200: {
            "description": "The image with the points found, their residuals a hundred times enlarged, and how well "
            "it was taken.",
            "content": {"image/png": {"schema": {"type": "string", "format": "binary"}}},
        },
        **problems(404, 409, 503),
    },
)
def get_overlay(measurement_id: str, service: ServiceDep) -> Response:
    """Draw the points found into the image."""
    measurement, path = measurements.get_original(service.installation, measurement_id)
    with service.installation.database.read() as records:
        points = measurements.get_points(records, measurement.id)
        quality = quality_document(measurements.get_measurement(records, measurement.id).measurement)
    if points is None:
        raise Conflict(
            "No points are known of this image.",
            "Wait until it is measured; where no target was found there is nothing to draw.",
            code="no_points",
        )
    return Response(service.painter.draw(path, points, quality), media_type="image/png")


@router.post("/measurements/{measurement_id}/retry", status_code=202, responses=problems(404, 409, 507))
def retry_measurement(measurement_id: str, service: ServiceDep, response: Response) -> MeasurementRead:
    """Compute a measurement again with today's code, whatever came of it before."""
    view = measurements.retry_measurement(service.installation, measurement_id)
    response.headers["Location"] = f"/v1/measurements/{measurement_id}"
    return measurement_document(view)


def _answer(response: Response, accepted: measurements.Accepted) -> MeasurementRead:
    response.status_code = 202 if accepted.is_new else 200
    response.headers["Location"] = f"/v1/measurements/{accepted.view.measurement.id}"
    return measurement_document(accepted.view)


def _check_target(service: Service, session_id: str, target_id: str | None) -> measurements.Intended:
    """Return which target the image is of; refuse a wrong one before the image is received."""
    with service.installation.database.read() as records:
        return measurements.check_target(find(records, Session, session_id), target_id)


def _refuse_unknown(request: Request) -> None:
    """Raise InvalidContent for query parameters that mean nothing here: a misspelt `cycle` would be lost for good."""
    known = {"cycle", "target_id", "focus_group", "joint_angles_deg", "captured_at", "filename"}
    unknown = sorted(set(request.query_params) - known)
    if unknown:
        raise InvalidContent(
            "The address holds query parameters that are not known.",
            f"Check their spelling; known are {', '.join(sorted(known))}.",
            errors=[(name[:200], "is not known") for name in unknown[:20]],
        )


def _joint_angles(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        return parse_joint_angles(text)
    except ValueError as error:
        raise InvalidContent(
            "The request's content is not valid.",
            "Correct the fields listed in errors.",
            errors=[("joint_angles_deg", str(error))],
        ) from None
