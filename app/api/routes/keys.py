"""/v1/keys"""

from __future__ import annotations

from datetime import timedelta

from fastapi import Response

from app.api.contract import Cursor, Limit, ServiceDep, contract_router, problems
from app.api.schemas.resources import KeyCreate, KeyCreated, KeyPage, KeyRead
from app.services import keys

router = contract_router(prefix="/v1/keys", tags=["keys"])


@router.post("", status_code=201, responses=problems(413, 415, 422, 507))
def create_key(body: KeyCreate, service: ServiceDep, response: Response) -> KeyCreated:
    """Make an API key; the key itself is shown in this answer and never again."""
    lifetime = timedelta(days=body.expires_in_days) if body.expires_in_days is not None else None
    new = keys.create_key(service.installation, body.name, body.scope, expires_in=lifetime)
    response.headers["Location"] = f"/v1/keys/{new.key.id}"
    return KeyCreated(**KeyRead.model_validate(new.key).model_dump(), key=new.secret_key)


@router.get("", responses=problems(422))
def list_keys(service: ServiceDep, limit: Limit = 50, cursor: Cursor = None) -> KeyPage:
    """List keys without their secrets, oldest first, revoked ones too."""
    rows, next_cursor = keys.list_keys(service.installation, limit=limit, cursor=cursor)
    return KeyPage(items=[KeyRead.model_validate(row) for row in rows], next_cursor=next_cursor)


@router.get("/{key_id}", responses=problems(404))
def get_key(key_id: str, service: ServiceDep) -> KeyRead:
    """Return one key that is still in force, without its secret."""
    return KeyRead.model_validate(keys.get_key(service.installation, key_id))


@router.delete("/{key_id}", status_code=204, responses=problems(404))
def revoke_key(key_id: str, service: ServiceDep) -> None:
    """Make a key useless from now on."""
    keys.revoke_key(service.installation, key_id)
