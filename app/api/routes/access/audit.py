"""/v1/audit"""

from __future__ import annotations

from typing import Annotated

from fastapi import Query
from pydantic import Field

from app.api.dependencies import AppContextDep, Cursor, Limit
from app.api.routing import api_router, problem_responses
from app.api.schemas.access.audit import AuditEntryRead, AuditPage
from app.api.schemas.common import PRINTABLE, Identifier, Moment
from app.records.audit import list_entries

router = api_router(prefix="/v1/audit", tags=["audit"])

ObjectId = Annotated[
    str,
    Field(min_length=1, max_length=128, pattern=PRINTABLE),
]


@router.get("", responses=problem_responses())
def list_audit(
    service: AppContextDep,
    key_id: Annotated[Identifier | None, Query(description="Entries of the key with this id alone.")] = None,
    object_id: Annotated[ObjectId | None, Query(description="Entries that name this id or pose tag.")] = None,
    since: Annotated[Moment | None, Query(description="Entries from this time on, RFC 3339.")] = None,
    until: Annotated[Moment | None, Query(description="Entries before this time, RFC 3339.")] = None,
    limit: Limit = 50,
    cursor: Cursor = None,
) -> AuditPage:
    """List who changed what, oldest first; every change has its entry, and no entry is ever changed or removed."""
    with service.installation.database.read() as records:
        rows, next_cursor = list_entries(
            records,
            key_id=key_id,
            object_id=object_id,
            since=since,
            until=until,
            limit=limit,
            cursor=cursor,
        )
    return AuditPage(
        items=[AuditEntryRead.model_validate(row) for row in rows], next_cursor=next_cursor, warnings=[]
    )
