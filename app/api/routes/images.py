"""/v1/sessions/{session_id}: images in, measurements out"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Path, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.concurrency import run_in_threadpool

from app.api.dependencies import AppContextDep, PosePath, SessionPath
from app.api.direct import DirectRoute
from app.api.json_body import json_answer
from app.api.responses import measurement_document, new_measurement_json
from app.api.routing import api_router, problem_responses
from app.api.schemas.common import (
    CAPTURED,
    MAX_BURST,
    MAX_CYCLE,
    POSE_LABEL,
    Burst,
    Cycle,
    Identifier,
    Moment,
    PoseTag,
    Sha256,
    Text,
    parse_joint_angles,
)
from app.api.schemas.fields import BURST, CYCLE, FOCUS_GROUP, POSE_ID
from app.api.schemas.measurements import (
    ImageList,
    MeasurementRead,
    MissingImages,
)
from app.api.uploads import (
    has_quota,
    receive_form,
    receive_raw,
    require_form_quota,
    require_image_type,
    require_quota,
)
from app.blobs.local import StagedBlob
from app.errors import InvalidContent
from app.http import invalid_request
from app.services import measurements
from app.services.installation.context import ServiceContext

router = api_router(prefix="/v1", tags=["measurements"])

_ACCEPTED: dict[int | str, dict[str, Any]] = {
    200: {"model": MeasurementRead, "description": "The same image is here already: the first measurement."},
    **problem_responses(404, 413, 415, 429, 507),
}
_RAW_BODY = {
    "requestBody": {
        "required": True,
        # Alone: generators of clients skip an operation that names types of `image/*`, which are taken, too.
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
JointList = Annotated[str, Field(min_length=1, max_length=400)]


class ImageForm(BaseModel):
    """The text fields of a multipart upload, without the file."""

    model_config = ConfigDict(extra="forbid")

    pose_id: PoseTag
    cycle: Cycle | None = None
    burst: Burst = 1
    target_id: Identifier | None = None
    focus_group: Text = "default"
    joint_angles_deg: JointList | None = None
    captured_at: Moment | None = None
    pose_label: Text | None = None


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
                        "burst": _form_field("integer", BURST, minimum=1, maximum=MAX_BURST, default=1),
                        "target_id": _form_field("string", _TARGET, minLength=1, maxLength=64),
                        "focus_group": _form_field("string", FOCUS_GROUP, minLength=1, maxLength=200),
                        "joint_angles_deg": _form_field("string", _ANGLES, minLength=1, maxLength=400),
                        "captured_at": _form_field("string", CAPTURED, format="date-time"),
                        "pose_label": _form_field("string", POSE_LABEL, minLength=1, maxLength=200),
                    },
                }
            }
        },
    }
}


async def put_image(
    request: Request,
    session_id: SessionPath,
    pose_id: PosePath,
    sha256: Annotated[Sha256, Path(description="SHA-256 of the body, 64 hex digits.")],
    service: AppContextDep,
    cycle: Annotated[Cycle | None, Query(description=CYCLE)] = None,
    burst: Annotated[Burst, Query(description=BURST)] = 1,
    target_id: Annotated[Identifier | None, Query(description=_TARGET)] = None,
    focus_group: Annotated[Text, Query(description=FOCUS_GROUP)] = "default",
    joint_angles_deg: Annotated[JointList | None, Query(description=_ANGLES)] = None,
    captured_at: Annotated[Moment | None, Query(description=CAPTURED)] = None,
    filename: Annotated[
        str | None, Query(max_length=1000, description="The file's name at the client; folders are dropped.")
    ] = None,
    pose_label: Annotated[Text | None, Query(description=POSE_LABEL)] = None,
) -> Response:
    """Upload one image of a pose as the raw body, under its SHA-256. Idempotent: safe to repeat."""
    metadata = measurements.Metadata(
        cycle=cycle,
        burst=burst,
        target_id=target_id,
        focus_group=focus_group,
        joint_angles_deg=_joint_angles(joint_angles_deg),
        captured_at=captured_at,
        filename=filename,
        pose_label=pose_label,
    )
    measurements.require_cycle(cycle, burst)
    require_image_type(request)
    installation = service.installation
    measurements.choose_target(request.state.targets, target_id)
    if has_quota(request):
        image = (session_id, pose_id, sha256, target_id)
        await run_in_threadpool(require_quota, installation, request, image)
    async with receive_raw(request, installation) as receiver:
        return await receiver.store(
            lambda staged: _stored(installation, session_id, pose_id, staged, metadata, sha256)
        )


router.add_api_route(
    "/sessions/{session_id}/poses/{pose_id}/images/{sha256}",
    put_image,
    methods=["PUT"],
    status_code=202,
    response_model=MeasurementRead,
    responses=_ACCEPTED,
    openapi_extra=_RAW_BODY,
    route_class_override=DirectRoute,
)


async def create_image(request: Request, session_id: SessionPath, service: AppContextDep) -> Response:
    """Send one image as a multipart form."""
    installation = service.installation
    if has_quota(request):
        await run_in_threadpool(require_form_quota, installation, request, session_id)
    async with receive_form(request, installation) as (receiver, form):
        try:
            fields = ImageForm.model_validate(form.fields)
        except ValidationError as error:
            raise invalid_request(error.errors()) from None
        metadata = measurements.Metadata(
            cycle=fields.cycle,
            burst=fields.burst,
            target_id=fields.target_id,
            focus_group=fields.focus_group,
            joint_angles_deg=_joint_angles(fields.joint_angles_deg),
            captured_at=fields.captured_at,
            filename=form.filename,
            pose_label=fields.pose_label,
        )
        measurements.require_cycle(metadata.cycle, metadata.burst)
        return await receiver.store(
            lambda staged: _stored(installation, session_id, fields.pose_id, staged, metadata, None)
        )


router.add_api_route(
    "/sessions/{session_id}/images",
    create_image,
    methods=["POST"],
    status_code=202,
    response_model=MeasurementRead,
    responses=_ACCEPTED,
    openapi_extra=_FORM_BODY,
    route_class_override=DirectRoute,
)


@router.post(
    "/sessions/{session_id}/images/missing",
    tags=["bulk"],
    response_model=MissingImages,
    responses=problem_responses(404, 413, 415),
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


def _stored(
    installation: ServiceContext,
    session_id: str,
    pose_id: str,
    staged: StagedBlob,
    metadata: measurements.Metadata,
    sha256: str | None,
) -> Response:
    """Store a received image and return the response, made in the same thread."""
    stored = measurements.store_image(
        installation, session_id, pose_id, staged, metadata, expected_sha256=sha256
    )
    if isinstance(stored, measurements.NewMeasurement):
        body, status, measurement_id = new_measurement_json(stored), 202, stored.id
    else:
        document = measurement_document(stored)
        body, status, measurement_id = document.model_dump_json().encode(), 200, document.id
    return Response(
        body, status, {"Location": f"/v1/measurements/{measurement_id}"}, media_type="application/json"
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
