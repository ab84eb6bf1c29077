"""/v1/sessions/{session_id}/measured-poses"""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Response

from app.api.dependencies import AcceptImplausible, AppContextDep, Cursor, Limit, SessionPath
from app.api.json_body import json_answer
from app.api.responses import stored_document, stored_documents
from app.api.routing import (
    CSV_BODY,
    api_router,
    problem_responses,
)
from app.api.schemas.common import Cycle, PoseTag
from app.api.schemas.measured_poses import (
    MeasuredPoseList,
    MeasuredPosePage,
    MeasuredPoseRead,
    MeasuredPosesDeleted,
)
from app.records.tables import MeasuredPose
from app.services import measured_poses

router = api_router(prefix="/v1/sessions/{session_id}/measured-poses", tags=["measured poses"])


@router.post(
    "",
    tags=["bulk"],
    response_model=MeasuredPosePage,
    responses=problem_responses(404, 409, 413, 415, 507),
    openapi_extra=CSV_BODY,
)
def put_measured_poses(
    session_id: SessionPath,
    body: MeasuredPoseList,
    service: AppContextDep,
    accept_implausible: AcceptImplausible = False,
) -> Response:
    """Store many poses that a laser tracker or another instrument measured: all or nothing.

    A JSON list, or a CSV table with the same names in its header, as for poses; `rotation` and `covariance` are one
    cell of numbers each, row after row.

    Lists whose distances between poses are about a thousandth or a thousand times the commanded ones are 422
    `implausible_unit`; without commanded poses, lists of several poses that lie within 5 mm of one another and scatter
    by less than 2 µm: they are almost surely in metres.

    A list has up to 10,000 of them; a session holds 20,000, and more are 409 `too_many_measured_poses`.

    Idempotent: a measured pose that is stored already is returned as it is. Different content for a stored cycle of a
    pose is 409.
    """
    readings = [measured_poses.Reading(**item.model_dump()) for item in body]
    measured_poses.check_readings(readings)
    with service.installation.database.write() as records:
        ids = measured_poses.put_measured_poses(
            records, session_id, readings, accept_implausible=accept_implausible
        )
    items = [
        MeasuredPoseRead.model_validate({"id": row_id, **item.model_dump()})
        for row_id, item in zip(ids, body, strict=True)
    ]
    return json_answer(MeasuredPosePage(items=items, next_cursor=None, warnings=[]))


@router.get("", responses=problem_responses(404))
def list_measured_poses(
    session_id: SessionPath,
    service: AppContextDep,
    pose_id: Annotated[
        PoseTag | None, Query(description="Measured poses of this pose alone, by the user's tag.")
    ] = None,
    limit: Limit = 50,
    cursor: Cursor = None,
) -> MeasuredPosePage:
    """List the poses that other instruments measured, oldest first."""
    with service.installation.database.read() as records:
        rows, next_cursor = measured_poses.list_measured_poses(
            records, session_id, pose_id=pose_id, limit=limit, cursor=cursor
        )
    items, warnings = stored_documents(_document, rows, lambda row: row.id)
    return MeasuredPosePage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.delete("", responses=problem_responses(404, 507))
def delete_measured_poses(
    session_id: SessionPath,
    service: AppContextDep,
    pose_id: Annotated[
        PoseTag | None, Query(description="Measured poses of this pose alone, by the user's tag.")
    ] = None,
    cycle: Annotated[Cycle | None, Query(description="Measured poses of this cycle alone.")] = None,
) -> MeasuredPosesDeleted:
    """Delete the poses that other instruments measured: all of them, or those of a pose, of a cycle or of both."""
    with service.installation.database.write() as records:
        deleted = measured_poses.delete_measured_poses(records, session_id, pose_id=pose_id, cycle=cycle)
    return MeasuredPosesDeleted(deleted=deleted)


def _document(row: MeasuredPose) -> MeasuredPoseRead:
    return stored_document(MeasuredPoseRead, row, "measured pose")
