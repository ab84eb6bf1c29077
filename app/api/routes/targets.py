"""/v1/targets"""

from __future__ import annotations

from fastapi import Response

from app.api.dependencies import AcceptImplausible, AppContextDep, Cursor, Limit, NameFilter, TargetPath
from app.api.responses import stored_document, stored_documents
from app.api.routing import api_router, problem_responses
from app.api.schemas.targets import TargetChange, TargetCreate, TargetPage, TargetRead
from app.records.tables import Target
from app.services import targets
from app.services.plausibility import check_pitch, check_pitch_uncertainty
from app.services.queries import get_or_raise, page_by_name

router = api_router(prefix="/v1/targets", tags=["targets"])


@router.post("", status_code=201, responses=problem_responses(413, 415, 507))
def create_target(
    body: TargetCreate,
    service: AppContextDep,
    response: Response,
    accept_implausible: AcceptImplausible = False,
) -> TargetRead:
    """Make a printed target.

    A pitch below 0.2 mm is 422 `implausible_unit`: it is almost surely in metres. So is a standard uncertainty of more
    than 5 % of the pitch, almost surely in micrometres. A certificate in another unit than the pitch, which it
    contradicts, is refused with `accept_implausible`, too.
    """
    if not accept_implausible:
        check_pitch(body.pitch_mm)
        check_pitch_uncertainty(
            body.pitch_mm,
            body.pitch_standard_uncertainty_mm,
            body.certificate.model_dump() if body.certificate is not None else None,
        )
    with service.installation.database.write() as records:
        target = targets.create_target(records, targets.NewTarget(**body.model_dump(mode="json")))
    response.headers["Location"] = f"/v1/targets/{target.id}"
    return _document(target)


@router.get("", responses=problem_responses())
def list_targets(
    service: AppContextDep, name: NameFilter = None, limit: Limit = 50, cursor: Cursor = None
) -> TargetPage:
    """List targets, oldest first: all, or those of one name."""
    with service.installation.database.read() as records:
        rows, next_cursor = page_by_name(records, Target, name=name, limit=limit, cursor=cursor)
    items, warnings = stored_documents(_document, rows, lambda row: row.id)
    return TargetPage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.get("/{target_id}", responses=problem_responses(404, 409))
def get_target(target_id: TargetPath, service: AppContextDep) -> TargetRead:
    """Return one target."""
    with service.installation.database.read() as records:
        return _document(get_or_raise(records, Target, target_id))


@router.patch("/{target_id}", responses=problem_responses(404, 409, 413, 415, 507))
def update_target(
    target_id: TargetPath,
    body: TargetChange,
    service: AppContextDep,
    accept_implausible: AcceptImplausible = False,
) -> TargetRead:
    """Change a target's name, or what is known of its print; analyses use the change from now on.

    What one image alone gave stays as it was computed, with the nominal grid. The grid itself never changes: for
    another pitch make another target and set the session's `target_ids` to it. A standard uncertainty of more than 5 %
    of the pitch is 422 `implausible_unit`.
    """
    changes = body.model_dump(mode="json", include=body.model_fields_set)
    with service.installation.database.write() as records:
        changed = targets.update_target(records, target_id, changes, accept_implausible=accept_implausible)
        return _document(changed)


@router.delete(
    "/{target_id}", status_code=204, response_class=Response, responses=problem_responses(404, 409, 507)
)
def delete_target(target_id: TargetPath, service: AppContextDep) -> None:
    """Delete a target that no session and no measurement refers to; else 409 `target_in_use`."""
    with service.installation.database.write() as records:
        targets.delete_target(records, target_id)


def _document(row: Target) -> TargetRead:
    return stored_document(TargetRead, row, "target")
