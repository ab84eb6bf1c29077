"""/v1/sessions/{session_id}: images in, measurements out"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Path, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.concurrency import run_in_threadpool

from app.api.dependencies import AppContext, AppContextDep, PosePath, SessionPath
from app.api.json_body import json_answer
from app.api.problems import invalid_request
from app.api.responses import measurement_document
from app.api.routing import api_router, problem_responses, query_parameters, refuse_unknown_parameters
from app.api.schemas.common import (
    CAPTURED,
    MAX_CYCLE,
    Cycle,
    Identifier,
    Moment,
    PoseTag,
    Sha256,
    Text,
    parse_joint_angles,
)
from app.api.schemas.fields import CYCLE, FOCUS_GROUP, POSE_ID
from app.api.schemas.measurements import (
    ImageList,
    MeasurementRead,
    MissingImages,
)
from app.api.uploads import FORM_ROOM, receive_form, receive_raw, require_image_type
from app.errors import InvalidContent, QuotaExceeded
from app.records.tables import ApiKey, Session
from app.services import measurements
from app.services.measurements import bytes_today, check_quota
from app.services.queries import get_or_raise

router = api_router(prefix="/v1", tags=["measurements"])

_ACCEPTED: dict[int | str, dict[str, Any]] = {
    200: {"model": MeasurementRead, "description": "The same image is here already: the first measurement."},
    **problem_responses(404, 413, 415, 422, 429, 507),
}
_RAW_BODY = {
    "requestBody": {
        "required": True,
        # Alone: generated clients send the first type they know, and know none of `image/*`, which is taken, too.
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
        "description": "The image file: PNG, JPEG, TIFF or BMP. A `Content-Type` of `image/*` is taken, too.",
    }
}
_TARGET = (
    "What the image shows; by default the session's only target. Where it has several, the image is searched for all "
    "of them, and each that it shows becomes a measurement."
)
_FILE = "The image file: PNG, JPEG, TIFF (its first page) or BMP, 8 or 16 bit, grey or colour."
_ANGLES = "Comma-separated joint angles, degrees; they override the pose's."
_FORM_FIELDS = 64 * 1024
"""More than the fields of a form and what stands between them take."""
JointList = Annotated[str, Field(min_length=1, max_length=400)]


class ImageForm(BaseModel):
    """The text fields of a multipart upload, without the file."""

    model_config = ConfigDict(extra="forbid")

    pose_id: PoseTag
    cycle: Cycle | None = None
    target_id: Identifier | None = None
    focus_group: Text = "default"
    joint_angles_deg: JointList | None = None
    captured_at: Moment | None = None


def _form_field(kind: str, description: str, **bounds: Any) -> dict[str, Any]:
    return {"type": kind, "description": description, **bounds}


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
                        "image": _form_field("string", _FILE, format="binary"),
                        "pose_id": _form_field(
                            "string",
                            POSE_ID,
                            minLength=1,
                            maxLength=128,
                            pattern="^[A-Za-z0-9_-][A-Za-z0-9._-]*$",
                        ),
                        "cycle": _form_field("integer", CYCLE, minimum=1, maximum=MAX_CYCLE),
                        "target_id": _form_field("string", _TARGET, minLength=1, maxLength=64),
                        "focus_group": _form_field("string", FOCUS_GROUP, minLength=1, maxLength=200),
                        "joint_angles_deg": _form_field("string", _ANGLES, minLength=1, maxLength=400),
                        "captured_at": _form_field("string", CAPTURED, format="date-time"),
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
    session_id: SessionPath,
    pose_id: PosePath,
    sha256: Annotated[Sha256, Path(description="SHA-256 of the body, 64 hex digits.")],
    service: AppContextDep,
    response: Response,
    cycle: Annotated[Cycle | None, Query(description=CYCLE)] = None,
    target_id: Annotated[Identifier | None, Query(description=_TARGET)] = None,
    focus_group: Annotated[Text, Query(description=FOCUS_GROUP)] = "default",
    joint_angles_deg: Annotated[JointList | None, Query(description=_ANGLES)] = None,
    captured_at: Annotated[Moment | None, Query(description=CAPTURED)] = None,
    filename: Annotated[
        str | None, Query(max_length=1000, description="The file's name at the client; folders are dropped.")
    ] = None,
) -> MeasurementRead:
    """Upload one image of a pose as the raw body, under its SHA-256. Idempotent: safe to repeat."""
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
    refuse_unknown_parameters(request, query_parameters(request.scope["route"].dependant))
    await run_in_threadpool(_check_quota, service, request, (session_id, pose_id, sha256, target_id))
    async with receive_raw(request, service.installation) as staged:
        upload = await run_in_threadpool(
            measurements.store_image,
            service.installation,
            session_id,
            pose_id,
            staged,
            metadata,
            expected_sha256=sha256,
            intended=intended,
        )
    return _respond(response, upload)


@router.post("/sessions/{session_id}/images", status_code=202, responses=_ACCEPTED, openapi_extra=_FORM_BODY)
async def create_image(
    request: Request, session_id: SessionPath, service: AppContextDep, response: Response
) -> MeasurementRead:
    """Send one image as a multipart form."""
    await run_in_threadpool(_check_form_quota, service, request, session_id)
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
        upload = await run_in_threadpool(
            measurements.store_image,
            service.installation,
            session_id,
            fields.pose_id,
            staged,
            metadata,
            expected_sha256=None,
        )
    return _respond(response, upload)


@router.post(
    "/sessions/{session_id}/images/missing",
    tags=["bulk"],
    response_model=MissingImages,
    responses=problem_responses(404, 413, 415, 422),
)
def find_missing_images(session_id: SessionPath, body: ImageList, service: AppContextDep) -> Response:
    """List those of up to 20,000 images that are to be sent: not here yet, or lost or damaged on the server's disk.

    An image is here where it has a measurement of the target that it names; without one, where it was searched for the
    session's targets. A file that is gone or has another length is noticed, and one that was found to be corrupt when
    it was last to be measured. Files are not read for this: `gridpose doctor --deep` does that.
    """
    with service.installation.database.read() as records:
        missing = measurements.find_missing(
            records,
            service.installation.blobs,
            session_id,
            [(image.pose_id, image.sha256, image.target_id) for image in body.images],
        )
    return json_answer(
        MissingImages.model_validate(
            {
                "missing": [
                    {"pose_id": pose_id, "sha256": sha256, "target_id": target_id}
                    for pose_id, sha256, target_id in missing
                ]
            }
        )
    )


def _respond(response: Response, upload: measurements.UploadResult) -> MeasurementRead:
    response.status_code = 202 if upload.is_new else 200
    response.headers["Location"] = f"/v1/measurements/{upload.view.measurement.id}"
    return measurement_document(upload.view)


def _check_target(service: AppContext, session_id: str, target_id: str | None) -> measurements.TargetChoice:
    """Return which target the image is of; refuse a wrong one before the image is received."""
    with service.installation.database.read() as records:
        return measurements.check_target(get_or_raise(records, Session, session_id), target_id)


def _check_quota(service: AppContext, request: Request, image: tuple[str, str, str, str | None]) -> None:
    """Refuse what is beyond the key's quota before it is received, unless it is here already and will not count."""
    key: ApiKey | None = request.state.key
    if key is None or key.bytes_per_day is None:
        return
    stated = request.headers.get("content-length", "")
    try:
        check_quota(key.bytes_per_day, bytes_today(key) or 0, int(stated) if stated.isdecimal() else 1)
    except QuotaExceeded:
        with service.installation.database.read() as records:
            if not measurements.is_stored(records, *image):
                raise


def _check_form_quota(service: AppContext, request: Request, session_id: str) -> None:
    """Refuse a form whose image is beyond the key's quota whatever else the form holds, before it is received.

    An image that is stored already does not count. The form, not yet received, says which image it is: a stored one of
    about this size may be it.
    """
    key: ApiKey | None = request.state.key
    if key is None or key.bytes_per_day is None:
        return
    stated = request.headers.get("content-length", "")
    size = int(stated) if stated.isdecimal() else None
    try:
        check_quota(key.bytes_per_day, bytes_today(key) or 0, max(1, (size or 0) - FORM_ROOM))
    except QuotaExceeded:
        if size is None:
            return
        with service.installation.database.read() as records:
            if not measurements.has_image_of_size(records, session_id, size - _FORM_FIELDS, size):
                raise


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
