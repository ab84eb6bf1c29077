"""/v1/robots/{robot_id}/events: what was done to a robot"""

from __future__ import annotations

from fastapi import Response

from app.api.dependencies import AppContextDep, Cursor, EventPath, Limit, RobotPath
from app.api.responses import stored_document, stored_documents
from app.api.routing import api_router, problem_responses
from app.api.schemas.documents.robot_events import RobotEventCreate, RobotEventPage, RobotEventRead
from app.records.tables import RobotEvent
from app.services import robots
from app.services.robots import NewEvent

router = api_router(prefix="/v1/robots/{robot_id}/events", tags=["robots"])


@router.post("", status_code=201, responses=problem_responses(404, 409, 413, 415, 507))
def create_robot_event(
    robot_id: RobotPath, body: RobotEventCreate, service: AppContextDep, response: Response
) -> RobotEventRead:
    """Note something done to a robot, such as maintenance: its history shows it and marks it in the charts."""
    with service.installation.database.write() as records:
        event = robots.add_event(records, robot_id, NewEvent(**body.model_dump()))
    response.headers["Location"] = f"/v1/robots/{robot_id}/events/{event.id}"
    return _document(event)


@router.get("", responses=problem_responses(404))
def list_robot_events(
    robot_id: RobotPath, service: AppContextDep, limit: Limit = 50, cursor: Cursor = None
) -> RobotEventPage:
    """List a robot's events in the order in which they were noted."""
    with service.installation.database.read() as records:
        rows, next_cursor = robots.list_events(records, robot_id, limit=limit, cursor=cursor)
    items, warnings = stored_documents(_document, rows, lambda row: row.id)
    return RobotEventPage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.delete("/{event_id}", status_code=204, response_class=Response, responses=problem_responses(404, 507))
def delete_robot_event(robot_id: RobotPath, event_id: EventPath, service: AppContextDep) -> None:
    """Delete an event that was noted in error."""
    with service.installation.database.write() as records:
        robots.delete_event(records, robot_id, event_id)


def _document(row: RobotEvent) -> RobotEventRead:
    return stored_document(RobotEventRead, row, "event")
