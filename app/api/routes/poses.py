"""/v1/sessions/{session_id}/poses"""

from __future__ import annotations

from fastapi import Request, Response

from app.api.dependencies import AcceptImplausible, AppContextDep, Cursor, Limit, PosePath, SessionPath
from app.api.json_body import json_answer
from app.api.responses import pose_document, stored_documents
from app.api.routing import CSV_BODY, api_router, problem_responses
from app.api.schemas.poses import PoseList, PosePage, PoseRead, PoseWrite
from app.http import holds
from app.services import poses
from app.services.plausibility import check_commands

router = api_router(prefix="/v1/sessions/{session_id}/poses", tags=["poses"])


@router.put(
    "/{pose_id}",
    responses={
        **problem_responses(404, 409, 413, 415, 507),
        201: {"model": PoseRead, "description": "The pose is new."},
    },
)
def put_pose(
    session_id: SessionPath,
    pose_id: PosePath,
    body: PoseWrite,
    service: AppContextDep,
    request: Request,
    response: Response,
    accept_implausible: AcceptImplausible = False,
) -> PoseRead:
    """Set the commanded values of a pose: 201 for a new pose, 200 for one replaced.

    Small angles with a quarter turn in radians among them, such as 1.5708, are 422 `implausible_unit`.

    A key of scope `ingest` may not change or remove a value that is stored: 409.
    """
    values = body.model_dump()
    if not accept_implausible:
        check_commands([values], in_list=False)
    commanded = poses.CommandedPose(**values)
    overwrite = holds(request, "upload")
    with service.installation.database.write() as records:
        pose, is_new = poses.put_pose(records, session_id, pose_id, commanded, overwrite=overwrite)
    if is_new:
        response.status_code = 201
        response.headers["Location"] = f"/v1/sessions/{session_id}/poses/{pose_id}"
    return pose_document(pose)


@router.post(
    "",
    tags=["bulk"],
    response_model=PosePage,
    responses=problem_responses(404, 409, 413, 415, 507),
    openapi_extra=CSV_BODY,
)
def put_poses(
    session_id: SessionPath,
    body: PoseList,
    service: AppContextDep,
    request: Request,
    accept_implausible: AcceptImplausible = False,
) -> Response:
    """Store many poses at once, new or replaced, up to 20,000: all or nothing.

    A JSON list, or a CSV table with the same names in its header, as the list of poses is answered: an empty cell is
    null, `position_mm` may be the columns `position_x_mm`, `position_y_mm` and `position_z_mm`, or `x_mm`, `y_mm` and
    `z_mm`, and `joint_angles_deg` one cell of numbers, or the columns `j1_deg`, `j2_deg`, ... Where columns are
    separated by semicolons or tabs, numbers may have decimal commas.

    Lists whose positions are all within 5 mm of the base's origin, whose joint angles are all below 7°, or whose roll,
    pitch and yaw hold quarter turns in radians are 422 `implausible_unit`: they are almost surely in metres or radians.

    A key of scope `ingest` may not change or remove a value that is stored: 409.
    """
    values = [item.model_dump(exclude={"pose_id"}) for item in body]
    if not accept_implausible:
        check_commands(values)
    items = [
        (item.pose_id, poses.CommandedPose(**commanded)) for item, commanded in zip(body, values, strict=True)
    ]
    with service.installation.database.write() as records:
        poses.put_poses(records, session_id, items, overwrite=holds(request, "upload"))
    return json_answer(
        PosePage(items=[PoseRead.model_validate(item) for item in body], next_cursor=None, warnings=[])
    )


@router.get("", responses=problem_responses(404))
def list_poses(
    session_id: SessionPath, service: AppContextDep, limit: Limit = 50, cursor: Cursor = None
) -> PosePage:
    """List a session's poses, oldest first."""
    with service.installation.database.read() as records:
        rows, next_cursor = poses.list_poses(records, session_id, limit=limit, cursor=cursor)
    items, warnings = stored_documents(pose_document, rows, lambda row: row.pose_id)
    return PosePage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.get("/{pose_id}", responses=problem_responses(404, 409))
def get_pose(session_id: SessionPath, pose_id: PosePath, service: AppContextDep) -> PoseRead:
    """Return one pose."""
    with service.installation.database.read() as records:
        return pose_document(poses.get_pose(records, session_id, pose_id))
