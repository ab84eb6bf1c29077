"""/v1/robots"""

from __future__ import annotations

import json
from typing import Annotated

from fastapi import Query, Request, Response
from starlette.concurrency import run_in_threadpool

from app.analyses.inputs.change_token import read_change_token
from app.api.dependencies import (
    AcceptImplausible,
    AppContext,
    AppContextDep,
    Cursor,
    Limit,
    NameFilter,
    RobotPath,
)
from app.api.representations import POSTED_ANALYSIS, PostedFormDep, answer_document, answer_in_form
from app.api.responses import stored_document, stored_documents
from app.api.routing import api_router, problem_responses
from app.api.schemas.analyses import Compensation, CompensationCreate, DhPlan, DhPlanCreate
from app.api.schemas.robots import RobotChange, RobotCreate, RobotPage, RobotRead
from app.http import RequesterDep, run_while_connected
from app.records.tables import Robot
from app.services import robots
from app.services.plausibility import check_datasheet, check_joints
from app.services.queries import get_or_raise, page_by_name
from app.services.robots import read_plan

router = api_router(prefix="/v1/robots", tags=["robots"])


@router.post("", status_code=201, responses=problem_responses(413, 415, 507))
def create_robot(
    body: RobotCreate,
    service: AppContextDep,
    response: Response,
    accept_implausible: AcceptImplausible = False,
) -> RobotRead:
    """Make a robot with its nominal Denavit-Hartenberg parameters.

    Twists or limits in radians, links and figures of the data sheet in metres, are 422 `implausible_unit`: they are
    small as no arm's are.
    """
    fields = body.model_dump()
    if not accept_implausible:
        check_joints(fields["joints"])
        check_datasheet(fields)
    with service.installation.database.write() as records:
        robot = robots.create_robot(records, fields)
    response.headers["Location"] = f"/v1/robots/{robot.id}"
    return _document(robot)


@router.get("", responses=problem_responses())
def list_robots(
    service: AppContextDep, name: NameFilter = None, limit: Limit = 50, cursor: Cursor = None
) -> RobotPage:
    """List robots, oldest first: all, or those of one name."""
    with service.installation.database.read() as records:
        rows, next_cursor = page_by_name(records, Robot, name=name, limit=limit, cursor=cursor)
    items, warnings = stored_documents(_document, rows, lambda row: row.id)
    return RobotPage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.get("/{robot_id}", responses=problem_responses(404, 409))
def get_robot(robot_id: RobotPath, service: AppContextDep) -> RobotRead:
    """Return one robot."""
    with service.installation.database.read() as records:
        return _document(get_or_raise(records, Robot, robot_id))


@router.patch("/{robot_id}", responses=problem_responses(404, 409, 413, 415, 507))
def update_robot(
    robot_id: RobotPath,
    body: RobotChange,
    service: AppContextDep,
    accept_implausible: AcceptImplausible = False,
) -> RobotRead:
    """Change a robot; analyses of its sessions use the change from now on.

    `joints` are sent whole. Values are 422 `implausible_unit` as in a new robot.
    """
    changes = body.model_dump(include=body.model_fields_set)
    if not accept_implausible:
        check_joints(changes.get("joints", ()))
        check_datasheet(changes)
    with service.installation.database.write() as records:
        return _document(robots.update_robot(records, robot_id, changes))


@router.delete(
    "/{robot_id}", status_code=204, response_class=Response, responses=problem_responses(404, 409, 507)
)
def delete_robot(robot_id: RobotPath, service: AppContextDep) -> None:
    """Delete a robot that no session names; else 409 `robot_in_use`."""
    with service.installation.database.write() as records:
        robots.delete_robot(records, robot_id)


def _document(row: Robot) -> RobotRead:
    return stored_document(RobotRead, row, "robot")


CurvesQuery = Annotated[
    bool,
    Query(
        description="Take joint curves (gears, encoders) as part of the correction without a second session that "
        "confirms them. On arms with harmonic drives they last for months; on others they may change by the next day."
    ),
]

plans = api_router(prefix="/v1/robots/{robot_id}", tags=["analyses"])


@plans.post(
    "/dh-plan",
    response_model=DhPlan,
    responses={**POSTED_ANALYSIS, **problem_responses(404, 409, 413, 415)},
)
async def create_dh_plan(
    robot_id: RobotPath,
    body: DhPlanCreate,
    request: Request,
    service: AppContextDep,
    requester: RequesterDep,
    form: PostedFormDep,
) -> Response:
    """Predict which parameters of a robot given poses would determine, and suggest the most informative further poses.

    Nothing is stored. The robot's nominal parameters are used, and a grid straight before the camera at home.
    """
    database = service.installation.database
    robot, target = await run_in_threadpool(read_plan, database, robot_id, body.target_id)
    asked = body.model_dump(exclude={"target_id"})
    plan = await run_while_connected(request, service.analyses.plan(robot, target, asked, requester))
    document = {"robot_id": robot_id, "target_id": body.target_id, **json.loads(plan)}
    return answer_document("dh_plan", DhPlan, document, form)


@plans.post(
    "/compensate",
    response_model=Compensation,
    responses={
        **POSTED_ANALYSIS,
        **problem_responses(404, 409, 413, 415),
    },
)
async def create_compensation(
    robot_id: RobotPath,
    body: CompensationCreate,
    request: Request,
    service: AppContextDep,
    form: PostedFormDep,
    curves: CurvesQuery = False,
) -> Response:
    """Correct commands by what a session identified of the robot: what to send, and what error is left. Nothing is
    stored.

    The chain corrects, with compliance where this predicts held-out poses better. Joint curves count where a second
    session confirms them, or `curves=true` asks for them. Commands outside the angles that were measured are left as
    they are, with the reason.
    """
    sessions = [body.session_id]
    if body.confirming_session_id is not None:
        sessions.append(body.confirming_session_id)
    limits, seconds_state = await run_in_threadpool(_read_correction, service, robot_id, sessions)
    settings = {
        "robot_id": robot_id,
        "estimator": body.estimator,
        "source": body.source,
        "curves": "true" if curves else "false",
        "limits": json.dumps(limits),
        "poses": json.dumps([pose.model_dump() for pose in body.poses]),
    }
    if body.confirming_session_id is not None:
        settings |= {
            "confirming_session_id": body.confirming_session_id,
            "confirming_session_state": seconds_state,
        }
    return await answer_in_form(request, "compensation", Compensation, body.session_id, settings, form)


def _read_correction(
    service: AppContext, robot_id: str, session_ids: list[str]
) -> tuple[list[tuple[float, float]], str]:
    """Return the limits of the joints, and what changes when the last of the sessions does."""
    with service.installation.database.read() as records:
        limits = robots.read_correction(records, robot_id, session_ids)
        return limits, read_change_token(records, session_ids[-1])
