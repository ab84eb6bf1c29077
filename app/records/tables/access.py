"""Tables of the installation, its API keys and its audit trail."""

from __future__ import annotations

from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.records.tables.base import JsonList, Table, made_by_column


class ApiKey(Table):
    """An API key: everything but the secret itself.

    `quota_bytes` is what came in on `quota_day` (YYYY-MM-DD, UTC), counted only while there is a `bytes_per_day`.
    """

    __tablename__ = "api_keys"
    __table_args__ = (sa.CheckConstraint("scope IN ('read', 'ingest', 'upload', 'admin')", name="scope"),)

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    scope: Mapped[str] = mapped_column(sa.String(16))
    secret_hmac: Mapped[str] = mapped_column(sa.String(64))
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    session_ids: Mapped[JsonList | None]
    bytes_per_day: Mapped[int | None] = mapped_column(sa.BigInteger())
    quota_day: Mapped[str | None] = mapped_column(sa.String(10))
    quota_bytes: Mapped[int] = mapped_column(sa.BigInteger(), default=0, server_default="0")
    last_used_at: Mapped[datetime | None]
    made_by: Mapped[str | None] = made_by_column()


class Installation(Table):
    """The one row that binds this database to its data folder, which names the same id.

    `services.installation.binding` compares the two.

    `pepper_check` identifies the pepper that the keys are hashed with; null until a program first opened both.
    """

    __tablename__ = "installation"
    __table_args__ = (sa.CheckConstraint("number = 1", name="one_row"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False, default=1)
    id: Mapped[str] = mapped_column(sa.String(40))
    created_at: Mapped[datetime]
    pepper_check: Mapped[str | None] = mapped_column(sa.String(64))


class AccessVersion(Table):
    """The one row that counts changes of keys, of sessions' targets and deletions of sessions, whoever makes them.

    Triggers of the database raise it in the transaction that changes them, so that what is kept in memory of both can
    be compared with it (`services.installation.access`). No row: nothing was ever changed.
    """

    __tablename__ = "access_version"
    __table_args__ = (sa.CheckConstraint("number = 1", name="one_row"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False, default=1)
    version: Mapped[int] = mapped_column(sa.BigInteger())


class AuditEntry(Table):
    """Who changed what, and when; triggers of the database refuse to change or delete entries.

    `action` is the operation's id in the HTTP contract. `object_ids` are those of the address,
    then those changed with them, then those made.
    """

    __tablename__ = "audit_entries"
    __table_args__ = (sa.Index("ix_audit_entries_key_id_id", "key_id", "id"),)

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    at: Mapped[datetime]
    actor: Mapped[str] = mapped_column(sa.String(16))
    key_id: Mapped[str | None] = mapped_column(sa.String(40))
    key_name: Mapped[str | None] = mapped_column(sa.String(200))
    client: Mapped[str | None] = mapped_column(sa.String(64))
    action: Mapped[str] = mapped_column(sa.String(64))
    object_ids: Mapped[JsonList] = mapped_column(sa.JSON())
    request_id: Mapped[str | None] = mapped_column(sa.String(64))
