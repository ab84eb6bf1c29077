"""/v1/keys"""

from __future__ import annotations

from datetime import timedelta

from fastapi import Response

from app.api.dependencies import AppContextDep, Cursor, KeyPath, Limit
from app.api.responses import stored_document, stored_documents
from app.api.routing import api_router, problem_responses
from app.api.schemas.access.keys import KeyChange, KeyCreate, KeyCreated, KeyPage, KeyRead
from app.records.tables import ApiKey
from app.services import keys
from app.services.measurements import bytes_today

router = api_router(prefix="/v1/keys", tags=["keys"])


@router.post("", status_code=201, responses=problem_responses(413, 415, 507))
def create_key(body: KeyCreate, service: AppContextDep, response: Response) -> KeyCreated:
    """Make an API key; the key itself is shown in this answer and never again."""
    lifetime = timedelta(days=body.expires_in_days) if body.expires_in_days is not None else None
    new = keys.create_key(
        service.installation,
        body.name,
        body.scope,
        expires_in=lifetime,
        session_ids=body.session_ids,
        bytes_per_day=body.bytes_per_day,
    )
    response.headers["Location"] = f"/v1/keys/{new.key.id}"
    return KeyCreated(**_document(new.key).model_dump(), key=new.secret_key)


@router.get("", responses=problem_responses())
def list_keys(service: AppContextDep, limit: Limit = 50, cursor: Cursor = None) -> KeyPage:
    """List keys without their secrets, oldest first, revoked ones too."""
    rows, next_cursor = keys.list_keys(service.installation, limit=limit, cursor=cursor)
    items, warnings = stored_documents(_document, rows, lambda row: row.id)
    return KeyPage(items=items, next_cursor=next_cursor, warnings=warnings)


@router.get("/{key_id}", responses=problem_responses(404, 409))
def get_key(key_id: KeyPath, service: AppContextDep) -> KeyRead:
    """Return one key without its secret, a revoked one too."""
    return _document(keys.get_key(service.installation, key_id))


@router.patch("/{key_id}", responses=problem_responses(404, 409, 413, 415, 507))
def update_key(key_id: KeyPath, body: KeyChange, service: AppContextDep) -> KeyRead:
    """Change the name or the quota of a key in force; its scope and sessions stay, for which there are new keys."""
    changes = body.model_dump(exclude_unset=True)
    return _document(keys.change_key(service.installation, key_id, changes))


@router.delete("/{key_id}", status_code=204, response_class=Response, responses=problem_responses(404))
def revoke_key(key_id: KeyPath, service: AppContextDep) -> None:
    """Make a key useless from now on."""
    keys.revoke_key(service.installation, key_id)


def _document(key: ApiKey) -> KeyRead:
    shown = {name: getattr(key, name) for name in KeyRead.model_fields if name != "bytes_today"}
    return stored_document(KeyRead, {**shown, "bytes_today": bytes_today(key)}, "key")
