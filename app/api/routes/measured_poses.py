"""/v1/sessions/{session_id}/measured-poses"""

from __future__ import annotations

from typing import Annotated

from fastapi import Query

from app.api.contract import Cursor, Limit, ServiceDep, contract_router, problems
from app.api.schemas.common import PoseTag
from app.api.schemas.measured_poses import MeasuredPoseList, MeasuredPosePage, MeasuredPoseRead
from app.services import measured_poses

router = contract_router(prefix="/v1/sessions/{session_id}/measured-poses", tags=["measured poses"])


@router.post("", tags=["bulk"], responses=problems(404, 409, 413, 415, 422, 507))
def put_measured_poses(session_id: str, body: MeasuredPoseList, service: ServiceDep) -> MeasuredPosePage:
    """Store many poses that a laser tracker or another instrument measured: all or nothing.

    Safe to send again for ever: a reading that is stored already is answered as it is. Another content for a stored
    cycle of a pose is 409.
    """
    readings = [measured_poses.Reading(**item.model_dump()) for item in body]
    measured_poses.check_readings(readings)
    with service.installation.database.write() as records:
        ids = measured_poses.put_measured_poses(records, session_id, readings)
    items = [
        MeasuredPoseRead.model_validate({"id": row_id, **item.model_dump()})
        for row_id, item in zip(ids, body, strict=True)
    ]
    return MeasuredPosePage(items=items, next_cursor=None)


@router.get("", responses=problems(404, 422))
def list_measured_poses(
    session_id: str,
    service: ServiceDep,
    pose_id: Annotated[PoseTag | None, Query(description="Those of one pose alone.")] = None,
    limit: Limit = 50,
    cursor: Cursor = None,
) -> MeasuredPosePage:
    """List the poses that other instruments measured, oldest first."""
    with service.installation.database.read() as records:
        rows, next_cursor = measured_poses.list_measured_poses(
            records, session_id, pose_id=pose_id, limit=limit, cursor=cursor
        )
    return MeasuredPosePage(
        items=[MeasuredPoseRead.model_validate(row) for row in rows], next_cursor=next_cursor
    )
