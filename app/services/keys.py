"""API keys: `gp_<keyid>_<secret>`, shown once, stored as HMAC-SHA256 under the server's pepper."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import sqlalchemy as sa

from app.errors import InvalidContent, NotFound
from app.records.ids import is_id, new_id
from app.records.pagination import page
from app.records.tables import SCOPES, ApiKey
from app.services.installation import Installation

_SHAPE = re.compile(r"gp_([0-9a-z]{26})_([0-9a-f]{64})", re.ASCII)
_PREFIX = "key_"


@dataclass(frozen=True, slots=True)
class NewKey:
    """A key just made; `secret_key` is the whole key and is never shown again."""

    key: ApiKey
    secret_key: str


def create_key(
    installation: Installation, name: str, scope: str, *, expires_in: timedelta | None = None
) -> NewKey:
    """Make a key with the scope `read`, `upload` or `admin`."""
    if scope not in SCOPES:
        raise InvalidContent(
            f"There is no scope of that name; use one of {', '.join(SCOPES)}.", code="invalid_scope"
        )
    if not 1 <= len(name) <= 200 or not name.isprintable():
        raise InvalidContent("A key's name has 1 to 200 printable characters.", code="invalid_name")
    key_id, secret = new_id("key"), secrets.token_hex(32)
    now = datetime.now(UTC)
    key = ApiKey(
        id=key_id,
        name=name,
        scope=scope,
        secret_hmac=_hash(installation.pepper, secret),
        created_at=now,
        expires_at=now + expires_in if expires_in is not None else None,
        revoked_at=None,
    )
    with installation.database.write() as session:
        session.add(key)
    return NewKey(key, f"gp_{key_id.removeprefix(_PREFIX)}_{secret}")


def find_key(installation: Installation, secret_key: str) -> ApiKey | None:
    """Return the valid key that `secret_key` is, or None; takes as long for a wrong secret as for a right one."""
    match = _SHAPE.fullmatch(secret_key)
    if match is None:
        return None
    key_id, secret = match.groups()
    with installation.database.read() as session:
        key = session.get(ApiKey, _PREFIX + key_id)
    if key is None or not hmac.compare_digest(key.secret_hmac, _hash(installation.pepper, secret)):
        return None
    if key.revoked_at is not None or (key.expires_at is not None and key.expires_at <= datetime.now(UTC)):
        return None
    return key


def list_keys(
    installation: Installation, *, limit: int = 500, cursor: str | None = None
) -> tuple[Sequence[ApiKey], str | None]:
    """Return keys, oldest first, revoked ones too."""
    with installation.database.read() as session:
        return page(session, sa.select(ApiKey), ApiKey.id, limit=limit, cursor=cursor)


def get_key(installation: Installation, key_id: str) -> ApiKey:
    """Return one key that is still in force, without its secret."""
    with installation.database.read() as session:
        key = session.get(ApiKey, key_id) if is_id(key_id) else None
    if key is None or key.revoked_at is not None:
        raise NotFound.of("key")
    return key


def revoke_key(installation: Installation, key_id: str) -> None:
    """Make a key useless from now on; revoking it again changes nothing."""
    with installation.database.write() as session:
        key = session.get(ApiKey, key_id) if is_id(key_id) else None
        if key is None:
            raise NotFound.of("key")
        if key.revoked_at is None:
            key.revoked_at = datetime.now(UTC)


def _hash(pepper: bytes, secret: str) -> str:
    return hmac.new(pepper, secret.encode(), hashlib.sha256).hexdigest()
