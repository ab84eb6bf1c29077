"""/v1/sessions"""

from __future__ import annotations

from fastapi import Response

from app.api.contract import Cursor, Limit, ServiceDep, contract_router, problems
from app.api.schemas.resources import SessionChange, SessionCreate, SessionPage, SessionRead
from app.api.views import session_document
from app.services import sessions

router = contract_router(prefix="/v1/sessions", tags=["sessions"])


@router.post("", status_code=201, responses=problems(413, 415, 422, 507))
def create_session(body: SessionCreate, service: ServiceDep, response: Response) -> SessionRead:
    """Begin a session: one camera looking at one or more targets."""
    with service.installation.database.write() as records:
        view = sessions.create_session(records, sessions.NewSession(**body.model_dump()))
    response.headers["Location"] = f"/v1/sessions/{view.session.id}"
    return session_document(view)


@router.get("", responses=problems(422))
def list_sessions(service: ServiceDep, limit: Limit = 50, cursor: Cursor = None) -> SessionPage:
    """List sessions, oldest first."""
    with service.installation.database.read() as records:
        views, next_cursor = sessions.list_sessions(records, limit=limit, cursor=cursor)
    return SessionPage(items=[session_document(view) for view in views], next_cursor=next_cursor)


@router.get("/{session_id}", responses=problems(404))
def get_session(session_id: str, service: ServiceDep) -> SessionRead:
    """Return one session with the counts of its measurements."""
    with service.installation.database.read() as records:
        view = sessions.get_session(records, session_id)
    return session_document(view)


@router.patch("/{session_id}", responses=problems(404, 413, 415, 422, 507))
def update_session(session_id: str, body: SessionChange, service: ServiceDep) -> SessionRead:
    """Change a session; measurements already computed stay as they are until they are retried."""
    with service.installation.database.write() as records:
        view = sessions.change_session(records, session_id, body.model_dump(exclude_unset=True))
    return session_document(view)


@router.delete("/{session_id}", status_code=204, responses=problems(404))
def delete_session(session_id: str, service: ServiceDep) -> None:
    """Delete a session with everything in it; originals that another session also holds stay."""
    sessions.delete_session(service.installation.database, service.installation.blobs, session_id)
