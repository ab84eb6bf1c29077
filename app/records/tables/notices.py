"""Tables of what others want to hear of, who is to be notified by HTTP, and the journal of that."""

from __future__ import annotations

from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Mapped, mapped_column

from app.records.tables.base import JsonList, JsonObject, Table, made_by_column


class Notice(Table):
    """Something that happened. It is written in the transaction of what happened.

    `number` is null until it was examined, and then counts on in the order of commits, whichever service examined it.
    `about` identifies what is to be notified once only; null for what may happen again.
    """

    __tablename__ = "notices"
    __table_args__ = (sa.UniqueConstraint("number"), sa.UniqueConstraint("about"))

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    number: Mapped[int | None] = mapped_column(sa.BigInteger())
    type: Mapped[str] = mapped_column(sa.String(32))
    at: Mapped[datetime]
    about: Mapped[str | None] = mapped_column(sa.String(64))
    data: Mapped[JsonObject] = mapped_column(sa.JSON())


class NoticeMark(Table):
    """What the search for measured sessions has to remember over a restart: a session in progress, or a moment."""

    __tablename__ = "notice_marks"

    name: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    at: Mapped[datetime]


class Webhook(Table):
    """An address that notices of some types are sent to.

    Its secret is derived from the installation's pepper and this id, and stored nowhere. `dropped` counts the notices
    that were not queued, since too many waited.
    """

    __tablename__ = "webhooks"

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    name: Mapped[str] = mapped_column(sa.String(200))
    url: Mapped[str] = mapped_column(sa.String(2000))
    types: Mapped[JsonList] = mapped_column(sa.JSON())
    created_at: Mapped[datetime]
    dropped: Mapped[int] = mapped_column(default=0, server_default="0")
    made_by: Mapped[str | None] = made_by_column()


class WebhookDelivery(Table):
    """One notice for one webhook: to be sent, sent, or given up. The row is queue and journal.

    While it is being sent, `next_attempt_at` is when another service may try, should this one die.
    """

    __tablename__ = "webhook_deliveries"
    __table_args__ = (
        sa.CheckConstraint("status IN ('waiting', 'delivered', 'failed')", name="status"),
        sa.UniqueConstraint("webhook_id", "notice_id"),
        sa.Index("ix_webhook_deliveries_webhook_id_id", "webhook_id", "id"),
        sa.Index("ix_webhook_deliveries_status_next_attempt_at", "status", "next_attempt_at"),
        sa.Index("ix_webhook_deliveries_notice_id", "notice_id"),
    )

    id: Mapped[str] = mapped_column(sa.String(40), primary_key=True)
    webhook_id: Mapped[str] = mapped_column(sa.ForeignKey("webhooks.id", ondelete="CASCADE"))
    notice_id: Mapped[str] = mapped_column(sa.ForeignKey("notices.id", ondelete="CASCADE"))
    status: Mapped[str] = mapped_column(sa.String(16))
    attempts: Mapped[int]
    created_at: Mapped[datetime]
    next_attempt_at: Mapped[datetime | None]
    last_attempt_at: Mapped[datetime | None]
    response_status: Mapped[int | None]
    failure: Mapped[str | None] = mapped_column(sa.String(200))
