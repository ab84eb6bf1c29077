"""API keys: `gp_<keyid>_<secret>`, shown once, stored as HMAC-SHA256 under the server's pepper; their last use."""

from __future__ import annotations

import hmac
import re
import secrets
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, TypedDict, Unpack

import sqlalchemy as sa

from app.errors import Conflict, InvalidContent, NotFound, ServiceError
from app.logs import Logger
from app.records.database import Database
from app.records.ids import is_id, new_id
from app.records.pagination import page
from app.records.readable import unreadable_columns
from app.records.tables import SCOPES, ApiKey, Session
from app.services.first_key import forget_key
from app.services.installation.context import ServiceContext
from app.services.installation.loop import Loop

_SHAPE = re.compile(r"gp_([0-9a-z]{26})_([0-9a-f]{64})", re.ASCII)
_PREFIX = "key_"


@dataclass(frozen=True, slots=True)
class NewKey:
    """A key just made; `secret_key` is the whole key and is never shown again."""

    key: ApiKey
    secret_key: str


class KeyLimits(TypedDict, total=False):
    """The limits of a key, as `draft_key` takes them."""

    expires_in: timedelta | None
    session_ids: Sequence[str] | None
    bytes_per_day: int | None


def create_key(
    installation: ServiceContext,
    name: str,
    scope: str,
    **limits: Unpack[KeyLimits],
) -> NewKey:
    """Make a key with the scope `read`, `ingest`, `upload` or `admin`, and store it. Raises as `draft_key` does."""
    new = draft_key(installation, name, scope, **limits)
    store_key(installation, new)
    return new


def draft_key(
    installation: ServiceContext,
    name: str,
    scope: str,
    *,
    expires_in: timedelta | None = None,
    session_ids: Sequence[str] | None = None,
    bytes_per_day: int | None = None,
) -> NewKey:
    """Return a key that opens nothing until it is stored. Raises InvalidContent for one that cannot be.

    `session_ids` are the sessions it is limited to, `bytes_per_day` how much it may send in a day; None: no limit.
    """
    if scope not in SCOPES:
        raise InvalidContent(
            f"There is no scope of that name; use one of {', '.join(SCOPES)}.", code="invalid_scope"
        )
    _check_name(name)
    if session_ids is not None and scope == "admin":
        raise InvalidContent(
            "A key of scope admin cannot be limited to sessions: it could make a key that is not.",
            "Use the scope read, ingest or upload.",
            code="invalid_scope",
            errors=[("session_ids", "must be null with the scope admin")],
        )
    if bytes_per_day is not None and bytes_per_day < 1:
        raise InvalidContent("A quota has at least one byte a day.", code="invalid_quota")
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
        session_ids=list(dict.fromkeys(session_ids)) if session_ids is not None else None,
        bytes_per_day=bytes_per_day,
        quota_day=None,
        quota_bytes=0,
        last_used_at=None,
    )
    return NewKey(key, f"gp_{key_id.removeprefix(_PREFIX)}_{secret}")


def store_key(installation: ServiceContext, new: NewKey) -> None:
    """Put a key into force. Raises InvalidContent where it is limited to a session that does not exist."""
    with installation.database.write() as records:
        if new.key.session_ids is not None:
            known = set(
                records.scalars(
                    sa.select(Session.id).where(
                        Session.id.in_([one for one in new.key.session_ids if is_id(one)])
                    )
                )
            )
            unknown = [place for place, one in enumerate(new.key.session_ids) if one not in known]
            if unknown or not known:
                raise InvalidContent(
                    "There is no such session.",
                    "Make the session first; every id in session_ids must exist.",
                    code="referenced_session_not_found",
                    errors=[(f"session_ids.{place}", "names no session") for place in unknown],
                )
        records.add(new.key)


def find_key(installation: ServiceContext, secret_key: str) -> ApiKey | None:
    """Return the valid key that `secret_key` is, or None; takes as long for a wrong secret as for a right one."""
    match = _SHAPE.fullmatch(secret_key)
    if match is None:
        return None
    key_id, secret = _PREFIX + match[1], match[2]
    facts = installation.access.current()
    with installation.database.read() as session:
        key = session.get(ApiKey, key_id)
    if key is None or unreadable_columns(key):
        return None  # one that cannot be read may be revoked or expired
    if not _opens(installation, key, secret):
        return None
    if facts is not None:
        facts.keys[key_id] = key
    return key


def recall_key(installation: ServiceContext, secret_key: str) -> ApiKey | None:
    """Return the valid key that `secret_key` is, as far as that is known without the database's row; waits for nothing.

    None says nothing: `find_key` decides. What its use changes (quota, time of use) may be older than the row's.
    """
    match = _SHAPE.fullmatch(secret_key)
    facts = installation.access.current() if match is not None else None
    if match is None or facts is None:
        return None
    key = facts.keys.get(_PREFIX + match[1])
    return key if key is not None and _opens(installation, key, match[2]) else None


def find_key_by_id(installation: ServiceContext, key_id: str) -> ApiKey | None:
    """Return a key that is in force, whose secret was checked before, or None."""
    with installation.database.read() as session:
        key = session.get(ApiKey, key_id) if is_id(key_id) else None
    return key if key is not None and not unreadable_columns(key) and _is_in_force(key) else None


def is_in_force(installation: ServiceContext, key_id: str) -> bool:
    """Return whether a key that was valid still is: neither revoked nor expired nor gone."""
    return find_key_by_id(installation, key_id) is not None


def list_keys(
    installation: ServiceContext, *, limit: int = 500, cursor: str | None = None
) -> tuple[Sequence[ApiKey], str | None]:
    """Return keys, oldest first, revoked ones too."""
    with installation.database.read() as session:
        return page(session, sa.select(ApiKey), ApiKey.id, limit=limit, cursor=cursor)


def keys_in_force(installation: ServiceContext) -> list[ApiKey]:
    """Return the keys that are valid now, oldest first."""
    with installation.database.read() as session:
        keys = session.scalars(sa.select(ApiKey).order_by(ApiKey.id)).all()
    return [key for key in keys if not unreadable_columns(key) and _is_in_force(key)]


def get_key(installation: ServiceContext, key_id: str) -> ApiKey:
    """Return one key without its secret, a revoked one too."""
    with installation.database.read() as session:
        key = session.get(ApiKey, key_id) if is_id(key_id) else None
    if key is None:
        raise NotFound.of("key")
    return key


def change_key(installation: ServiceContext, key_id: str, changes: Mapping[str, Any]) -> ApiKey:
    """Change the name or the quota of a key in force."""
    if "name" in changes:
        _check_name(changes["name"])
    with installation.database.write() as records:
        key = records.get(ApiKey, key_id, with_for_update=True) if is_id(key_id) else None
        if key is None:
            raise NotFound.of("key")
        if key.revoked_at is not None:
            raise Conflict(
                "The key is revoked, which cannot be undone.", code="key_revoked", advice="Create a new key."
            )
        for field in ("name", "bytes_per_day"):
            if field in changes:
                setattr(key, field, changes[field])
    return key


def revoke_key(installation: ServiceContext, key_id: str) -> None:
    """Make a key useless from now on; revoking it again changes nothing."""
    with installation.database.write() as session:
        key = session.get(ApiKey, key_id) if is_id(key_id) else None
        if key is None:
            raise NotFound.of("key")
        if key.revoked_at is None or unreadable_columns(key):
            key.revoked_at = datetime.now(UTC)
    forget_key(installation.settings.data_dir, key_id)


def _check_name(name: str) -> None:
    if not 1 <= len(name) <= 200 or not name.isprintable():
        raise InvalidContent("A key's name has 1 to 200 printable characters.", code="invalid_name")


def _is_in_force(key: ApiKey) -> bool:
    return key.revoked_at is None and (key.expires_at is None or key.expires_at > datetime.now(UTC))


def _opens(installation: ServiceContext, key: ApiKey, secret: str) -> bool:
    """Return whether `secret` is the key's and the key is in force."""
    return hmac.compare_digest(
        key.secret_hmac.encode(), _hash(installation.pepper, secret).encode()
    ) and _is_in_force(key)


def _hash(pepper: bytes, secret: str) -> str:
    return hmac.digest(pepper, secret.encode(), "sha256").hex()


WRITE_EVERY_S = 60.0
MAX_AHEAD = timedelta(hours=1)
"""A use that lies further ahead was noted by a clock that was wrong; less may be another service's."""
log = Logger(__name__)


class KeyUse:
    """The last use of each key since it was last written; safe to use from several threads."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._seen: dict[str, datetime] = {}
        self._lock = threading.Lock()
        self._loop = Loop("key-use", self.write, WRITE_EVERY_S)

    def start(self) -> None:
        """Begin to write once a minute."""
        self._loop.start()

    def stop(self) -> None:
        """Write what is not written yet, and end."""
        self._loop.stop()
        self.write()

    def note(self, key_id: str) -> None:
        """Note that a key is used now; no input or output."""
        with self._lock:
            self._seen[key_id] = datetime.now(UTC)

    def write(self) -> None:
        """Bring what was noted to the database in one transaction; where that fails, the next time tries again."""
        with self._lock:
            seen, self._seen = self._seen, {}
        if not seen:
            return
        try:
            with self._database.write() as records:
                # One order, so that two processes never wait in a ring.
                for key_id, moment in sorted(seen.items()):
                    records.execute(
                        sa.update(ApiKey)
                        .where(
                            ApiKey.id == key_id,
                            sa.or_(
                                ApiKey.last_used_at.is_(None),
                                ApiKey.last_used_at < moment,
                                ApiKey.last_used_at > moment + MAX_AHEAD,
                            ),
                        )
                        .values(last_used_at=moment)
                        .execution_options(synchronize_session=False)
                    )
        except (ServiceError, sa.exc.SQLAlchemyError) as error:
            # No trace of a full disk or a busy database, which pass: the database's own line has the reason.
            reason = error.code if isinstance(error, ServiceError) else type(error).__name__
            log.warning("key_use_not_written", keys=len(seen), reason=reason)
            with self._lock:
                self._seen = {**seen, **self._seen}
