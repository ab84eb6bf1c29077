"""Notices: written with what happened, and numbered and queued for webhooks once they were examined."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Literal

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.ids import new_id
from app.records.readable import unreadable_columns
from app.records.tables import Notice, Session, Webhook, WebhookDelivery

NoticeType = Literal[
    "session.measured",
    "report.ready",
    "report.failed",
    "verdict.changed",
    "robot.alarm",
    "qualification.made",
]
"""What a webhook can be made for; `webhook.test` is sent to the one that is tested."""
MAX_WAITING = 1000
"""Deliveries that wait for one webhook; more are not queued, and counted."""
_AT_ONCE = 50


def note(
    records: orm.Session, kind: str, data: Mapping[str, Any], *, about: Iterable[str] | None = None
) -> Notice | None:
    """Write a notice in the caller's transaction; None where there is one `about` the same already."""
    digest = None
    if about is not None:
        digest = hashlib.sha256("\0".join((kind, *about)).encode()).hexdigest()
        if records.scalar(sa.select(Notice.id).where(Notice.about == digest)) is not None:
            return None
    row = Notice(id=new_id("ntc"), type=kind, at=datetime.now(UTC), about=digest, data=dict(data))
    records.add(row)
    records.flush()
    return row


def of_session(records: orm.Session, session_id: str) -> dict[str, str | None]:
    """Return what notices say of a session: its id, name and robot, null where the session is gone."""
    found = records.execute(
        sa.select(Session.name, Session.robot_id).where(Session.id == session_id)
    ).one_or_none()
    name, robot_id = (None, None) if found is None else (found.name, found.robot_id)
    return {"session_id": session_id, "session_name": name, "robot_id": robot_id}


def document_of(row: Notice) -> dict[str, Any]:
    """Return a notice as receivers get it: what, when, and about whom."""
    at = row.at.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return {"id": row.id, "type": row.type, "timestamp": at, "data": row.data}


def unexamined(records: orm.Session) -> Sequence[Notice]:
    """Return the oldest notices that nobody examined yet."""
    return records.scalars(
        sa.select(Notice).where(Notice.number.is_(None)).order_by(Notice.id).limit(_AT_ONCE)
    ).all()


def take_up(records: orm.Session, notice_id: str) -> bool:
    """Number a notice and queue it for the webhooks of its type; return whether it was to be done.

    Two services that do so at once give one of them a number that is taken: that transaction fails, and is repeated.
    """
    row = records.get(Notice, notice_id, with_for_update=True, populate_existing=True)
    if row is None or row.number is not None:
        return False
    row.number = latest_number(records) + 1
    records.flush()
    if unreadable_columns(row):
        return True
    for webhook in records.scalars(sa.select(Webhook).order_by(Webhook.id)):
        if not unreadable_columns(webhook) and row.type in webhook.types:
            queue_for(records, webhook, row)
    return True


def queue_for(records: orm.Session, webhook: Webhook, row: Notice) -> WebhookDelivery | None:
    """Queue a notice for a webhook; None, and counted, where too many wait."""
    waiting = records.scalar(
        sa.select(sa.func.count()).where(
            WebhookDelivery.webhook_id == webhook.id, WebhookDelivery.status == "waiting"
        )
    )
    if (waiting or 0) >= MAX_WAITING:
        webhook.dropped += 1
        return None
    now = datetime.now(UTC)
    delivery = WebhookDelivery(
        id=new_id("dlv"),
        webhook_id=webhook.id,
        notice_id=row.id,
        status="waiting",
        attempts=0,
        created_at=now,
        next_attempt_at=now,
    )
    records.add(delivery)
    records.flush()
    return delivery


def latest_number(records: orm.Session) -> int:
    """Return the number of the notice examined last, 0 before the first."""
    return records.scalar(sa.select(sa.func.max(Notice.number))) or 0


def numbered_after(records: orm.Session, number: int, *, limit: int) -> Sequence[Notice]:
    """Return the notices that follow a number, in order."""
    return records.scalars(
        sa.select(Notice).where(Notice.number > number).order_by(Notice.number).limit(limit)
    ).all()
