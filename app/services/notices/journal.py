"""The journal of deliveries, which is their queue: claimed for a while, then sent, put off, or given up."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict, NotFound
from app.records.ids import is_id
from app.records.pagination import page
from app.records.readable import unreadable_columns
from app.records.tables import Notice, Webhook, WebhookDelivery
from app.services.notices.noting import document_of
from app.services.queries import get_or_raise

_FIRST_S, _FACTOR, _MAX_S = 10.0, 3.0, 6 * 3600.0
ATTEMPTS = 18
"""Over three days: a weekend without a receiver loses nothing."""
LEASE_S = 60.0
"""For how long a service that sends has a delivery; longer than any attempt takes."""


@dataclass(frozen=True, slots=True)
class Claimed:
    """A delivery to send now; `attempt` counts from 1."""

    delivery_id: str
    webhook_id: str
    url: str
    attempt: int
    document: dict[str, Any]


def wait_s(attempt: int) -> float:
    """Return how long to wait after this attempt, which failed: 10 s, 30 s, 90 s, ..., 6 h."""
    return min(_MAX_S, _FIRST_S * _FACTOR ** (attempt - 1))


def claim_due(records: orm.Session, now: datetime, *, besides: Collection[str] = ()) -> list[Claimed]:
    """Take the delivery that waits longest of each webhook but those `besides`, of those that are due.

    One that would be due later than any wait may last is due as well: the clock was set back.
    """
    due = sa.or_(
        WebhookDelivery.next_attempt_at <= now,
        WebhookDelivery.next_attempt_at > now + timedelta(seconds=_MAX_S + LEASE_S),
    )
    first = (
        sa.select(sa.func.min(WebhookDelivery.id))
        .where(WebhookDelivery.status == "waiting", due, WebhookDelivery.webhook_id.not_in(besides))
        .group_by(WebhookDelivery.webhook_id)
    )
    claimed = []
    rows = records.scalars(
        sa.select(WebhookDelivery)
        .where(WebhookDelivery.id.in_(first), WebhookDelivery.status == "waiting", due)
        .with_for_update(skip_locked=True)
    ).all()
    for row in rows:
        webhook = records.get_one(Webhook, row.webhook_id)
        notice = records.get_one(Notice, row.notice_id)
        if unreadable_columns(webhook) or unreadable_columns(notice):
            row.status, row.next_attempt_at = "failed", None
            row.failure = "What is stored of the webhook or of the notice cannot be read."
            continue
        row.attempts += 1
        row.last_attempt_at = now
        row.next_attempt_at = now + timedelta(seconds=LEASE_S)
        claimed.append(Claimed(row.id, row.webhook_id, webhook.url, row.attempts, document_of(notice)))
    return claimed


def save_attempt(
    records: orm.Session, one: Claimed, *, response_status: int | None, failure: str | None
) -> None:
    """Store what came of an attempt: delivered where there was no `failure`. A webhook may be deleted meanwhile."""
    row = records.get(WebhookDelivery, one.delivery_id, with_for_update=True)
    if row is None or row.attempts != one.attempt:
        return
    row.response_status, row.failure = response_status, None if failure is None else failure[:200]
    if failure is None:
        row.status, row.next_attempt_at = "delivered", None
    elif one.attempt >= ATTEMPTS:
        row.status, row.next_attempt_at = "failed", None
    else:
        row.next_attempt_at = datetime.now(UTC) + timedelta(seconds=wait_s(one.attempt))


def list_deliveries(
    records: orm.Session, webhook_id: str, status: str | None, *, limit: int, cursor: str | None
) -> tuple[Sequence[WebhookDelivery], str | None]:
    """Return one page of a webhook's journal, oldest first. Raises NotFound."""
    get_or_raise(records, Webhook, webhook_id)
    statement = sa.select(WebhookDelivery).where(WebhookDelivery.webhook_id == webhook_id)
    if status is not None:
        statement = statement.where(WebhookDelivery.status == status)
    return page(records, statement, WebhookDelivery.id, limit=limit, cursor=cursor)


def types_of(records: orm.Session, rows: Sequence[WebhookDelivery]) -> dict[str, str]:
    """Return the types of the notices of these deliveries, by the notices' ids."""
    ids = {row.notice_id for row in rows}
    found = records.execute(sa.select(Notice.id, Notice.type).where(Notice.id.in_(ids)))
    return {row.id: row.type for row in found}


def redeliver(records: orm.Session, webhook_id: str, delivery_id: str) -> WebhookDelivery:
    """Queue a delivery again, under its id, whatever came of it. Raises NotFound, Conflict while it waits."""
    get_or_raise(records, Webhook, webhook_id)
    row = records.get(WebhookDelivery, delivery_id, with_for_update=True) if is_id(delivery_id) else None
    if row is None or row.webhook_id != webhook_id:
        raise NotFound.of("delivery")
    if row.status == "waiting" and row.attempts == 0:
        raise Conflict("The delivery waits for its first attempt.", "Wait for it.", code="delivery_waiting")
    row.status, row.attempts, row.next_attempt_at = "waiting", 0, datetime.now(UTC)
    return row


def counts_by_status(records: orm.Session) -> dict[str, int]:
    """Return how many deliveries there are of each status."""
    found = records.execute(
        sa.select(WebhookDelivery.status, sa.func.count()).group_by(WebhookDelivery.status)
    ).all()
    return {"waiting": 0, "delivered": 0, "failed": 0} | {row[0]: row[1] for row in found}
