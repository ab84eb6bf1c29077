"""/v1/targets"""

from __future__ import annotations

from fastapi import Response

from app.api.contract import Cursor, Limit, ServiceDep, contract_router, problems
from app.api.schemas.resources import TargetCreate, TargetPage, TargetRead
from app.records.tables import Target
from app.services import targets
from app.services.lookup import find

router = contract_router(prefix="/v1/targets", tags=["targets"])


@router.post("", status_code=201, responses=problems(413, 415, 422, 507))
def create_target(body: TargetCreate, service: ServiceDep, response: Response) -> TargetRead:
    """Make a printed target."""
    with service.installation.database.write() as records:
        target = targets.create_target(records, targets.NewTarget(**body.model_dump()))
    response.headers["Location"] = f"/v1/targets/{target.id}"
    return TargetRead.model_validate(target)


@router.get("", responses=problems(422))
def list_targets(service: ServiceDep, limit: Limit = 50, cursor: Cursor = None) -> TargetPage:
    """List targets, oldest first."""
    with service.installation.database.read() as records:
        rows, next_cursor = targets.list_targets(records, limit=limit, cursor=cursor)
    return TargetPage(items=[TargetRead.model_validate(row) for row in rows], next_cursor=next_cursor)


@router.get("/{target_id}", responses=problems(404))
def get_target(target_id: str, service: ServiceDep) -> TargetRead:
    """Return one target."""
    with service.installation.database.read() as records:
        return TargetRead.model_validate(find(records, Target, target_id))
