"""/v1/robots"""

from __future__ import annotations

from fastapi import Response

from app.api.contract import Cursor, Limit, ServiceDep, contract_router, problems
from app.api.schemas.resources import RobotCreate, RobotPage, RobotRead
from app.records.tables import Robot
from app.services import robots
from app.services.lookup import find

router = contract_router(prefix="/v1/robots", tags=["robots"])


@router.post("", status_code=201, responses=problems(413, 415, 422, 507))
def create_robot(body: RobotCreate, service: ServiceDep, response: Response) -> RobotRead:
    """Make a robot with its nominal Denavit-Hartenberg parameters."""
    with service.installation.database.write() as records:
        robot = robots.create_robot(records, **body.model_dump())
    response.headers["Location"] = f"/v1/robots/{robot.id}"
    return RobotRead.model_validate(robot)


@router.get("", responses=problems(422))
def list_robots(service: ServiceDep, limit: Limit = 50, cursor: Cursor = None) -> RobotPage:
    """List robots, oldest first."""
    with service.installation.database.read() as records:
        rows, next_cursor = robots.list_robots(records, limit=limit, cursor=cursor)
    return RobotPage(items=[RobotRead.model_validate(row) for row in rows], next_cursor=next_cursor)


@router.get("/{robot_id}", responses=problems(404))
def get_robot(robot_id: str, service: ServiceDep) -> RobotRead:
    """Return one robot."""
    with service.installation.database.read() as records:
        return RobotRead.model_validate(find(records, Robot, robot_id))
