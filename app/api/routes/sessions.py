"""/v1/sessions"""

from __future__ import annotations

from fastapi import Response

from app.api.dependencies import AcceptImplausible, AppContextDep, Cursor, Limit, NameFilter, SessionPath
from app.api.responses import session_document, stored_documents
from app.api.routing import api_router, problem_responses
from app.api.schemas.sessions import (
    ReprocessCreate,
    ReprocessRead,
    SessionChange,
    SessionCreate,
    SessionPage,
    SessionRead,
)
from app.services import measurements, sessions
from app.services.plausibility import check_intrinsics, check_lens

_FAILED_ALONE = ReprocessCreate()
router = api_router(prefix="/v1/sessions", tags=["sessions"])


@router.post("", status_code=201, responses=problem_responses(413, 415, 507))
def create_session(
    body: SessionCreate,
    service: AppContextDep,
    response: Response,
    accept_implausible: AcceptImplausible = False,
) -> SessionRead:
    """Begin a session: one camera looking at one or more targets.

    A `lens` in metres or with a pixel pitch in mm, and `intrinsics` in mm or in shares of the image, are 422
    `implausible_unit`.
    """
    if not accept_implausible:
        _check_camera(body)
    with service.installation.database.write() as records:
        view = sessions.create_session(records, sessions.NewSession(**body.model_dump()))
    response.headers["Location"] = f"/v1/sessions/{view.session.id}"
    return session_document(view)


@router.get("", responses=problem_responses())
def list_sessions(
    service: AppContextDep, name: NameFilter = None, limit: Limit = 50, cursor: Cursor = None
) -> SessionPage:
    """List sessions, oldest first: all, or those of one name."""
    with service.installation.database.read() as records:
        views, next_cursor = sessions.list_sessions(records, name=name, limit=limit, cursor=cursor)
    items, warnings = stored_documents(session_document, views, lambda view: view.session.id)
    return SessionPage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.get("/{session_id}", responses=problem_responses(404, 409))
def get_session(session_id: SessionPath, service: AppContextDep) -> SessionRead:
    """Return one session with the counts of its measurements."""
    with service.installation.database.read() as records:
        view = sessions.get_session(records, session_id)
    return session_document(view)


@router.patch("/{session_id}", responses=problem_responses(404, 409, 413, 415, 507))
def update_session(
    session_id: SessionPath,
    body: SessionChange,
    service: AppContextDep,
    accept_implausible: AcceptImplausible = False,
) -> SessionRead:
    """Change a session; results stay until they are computed again.

    With other `target_ids`, images with a measurement whose target went are searched again, and images sent without a
    target are searched for new targets. After a change of `lens` or `intrinsics`, ask for `reprocess`; they are 422
    `implausible_unit` as in a new session.
    """
    if not accept_implausible:
        _check_camera(body)
    with service.installation.database.write() as records:
        # Whole values of the fields sent: within them, what is left away is null.
        changes = body.model_dump(include=body.model_fields_set)
        view = sessions.update_session(records, session_id, changes)
    service.installation.queue.notify()
    return session_document(view)


@router.post("/{session_id}/reprocess", status_code=202, responses=problem_responses(404, 413, 415, 507))
def reprocess_session(
    session_id: SessionPath,
    service: AppContextDep,
    response: Response,
    body: ReprocessCreate = _FAILED_ALONE,
) -> ReprocessRead:
    """Compute a session's measurements again, all or those that failed; results stay until others replace them.

    Without a body, those that failed.
    """
    requeued = measurements.reprocess_session(service.installation, session_id, only=body.only)
    response.headers["Location"] = f"/v1/sessions/{session_id}"
    with service.installation.database.read() as records:
        counts = sessions.get_session(records, session_id).counts
    return ReprocessRead.model_validate({"requeued": requeued, "counts": counts})


@router.delete("/{session_id}", status_code=204, response_class=Response, responses=problem_responses(404))
def delete_session(session_id: SessionPath, service: AppContextDep) -> None:
    """Delete a session with everything in it; originals that another session also holds stay."""
    sessions.delete_session(service.installation.database, service.installation.blobs, session_id)


def _check_camera(body: SessionCreate | SessionChange) -> None:
    check_lens(body.lens.model_dump() if body.lens else None)
    check_intrinsics(body.intrinsics.model_dump() if body.intrinsics else None)
