"""/v1/sessions/{session_id}/poses"""

from __future__ import annotations

from typing import Annotated

from fastapi import Path, Response

from app.api.contract import Cursor, Limit, ServiceDep, contract_router, problems
from app.api.schemas.common import PoseTag
from app.api.schemas.measurements import PoseList, PosePage, PoseRead, PoseWrite
from app.api.views import pose_document
from app.services import poses

router = contract_router(prefix="/v1/sessions/{session_id}/poses", tags=["poses"])
PosePath = Annotated[PoseTag, Path(description="The user's own tag of the pose.")]


@router.put(
    "/{pose_id}",
    responses={
        **problems(404, 413, 415, 422, 507),
        201: {"model": PoseRead, "description": "The pose is new."},
    },
)
def put_pose(
    session_id: str, pose_id: PosePath, body: PoseWrite, service: ServiceDep, response: Response
) -> PoseRead:
    """Say what the robot was told at a pose: 201 for a new pose, 200 for one replaced."""
    with service.installation.database.write() as records:
        pose, is_new = poses.put_pose(records, session_id, pose_id, poses.CommandedPose(**body.model_dump()))
    if is_new:
        response.status_code = 201
        response.headers["Location"] = f"/v1/sessions/{session_id}/poses/{pose_id}"
    return pose_document(pose)


@router.post("", tags=["bulk"], responses=problems(404, 413, 415, 422, 507))
def put_poses(session_id: str, body: PoseList, service: ServiceDep) -> PosePage:
    """Store many poses at once, new or replaced: all or nothing."""
    items = [(item.pose_id, poses.CommandedPose(**item.model_dump(exclude={"pose_id"}))) for item in body]
    with service.installation.database.write() as records:
        poses.put_poses(records, session_id, items)
    return PosePage(items=[PoseRead.model_validate(item) for item in body], next_cursor=None)


@router.get("", responses=problems(404, 422))
def list_poses(session_id: str, service: ServiceDep, limit: Limit = 50, cursor: Cursor = None) -> PosePage:
    """List a session's poses, oldest first."""
    with service.installation.database.read() as records:
        rows, next_cursor = poses.list_poses(records, session_id, limit=limit, cursor=cursor)
    return PosePage(items=[pose_document(row) for row in rows], next_cursor=next_cursor)


@router.get("/{pose_id}", responses=problems(404, 422))
def get_pose(session_id: str, pose_id: PosePath, service: ServiceDep) -> PoseRead:
    """Return one pose."""
    with service.installation.database.read() as records:
        return pose_document(poses.get_pose(records, session_id, pose_id))
