"""How long notices and the journal are kept."""

from __future__ import annotations

from datetime import datetime, timedelta

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.tables import Notice, WebhookDelivery

MAX_AGE = timedelta(days=30)
MAX_NOTICES = 10_000
_FOR_LONGER = "robot.alarm"
"""An alarm is in a robot's history for years and is notified once: its notice says that it was."""


def prune(records: orm.Session, now: datetime) -> int:
    """Delete examined notices that are too old or too many, with their deliveries; return how many.

    What waits to be delivered stays, but for the cap.
    """
    waiting = sa.exists().where(WebhookDelivery.notice_id == Notice.id, WebhookDelivery.status == "waiting")
    old = sa.and_(Notice.at < now - MAX_AGE, Notice.type != _FOR_LONGER, ~waiting)
    beyond = records.scalar(sa.select(Notice.id).order_by(Notice.id.desc()).offset(MAX_NOTICES).limit(1))
    gone = old if beyond is None else sa.or_(old, Notice.id <= beyond)
    # Of all, the latest stays: numbers go on from it.
    last = sa.select(sa.func.max(Notice.number)).scalar_subquery()
    ids = records.scalars(sa.select(Notice.id).where(gone, Notice.number < last)).all()
    for start in range(0, len(ids), 500):
        records.execute(sa.delete(Notice).where(Notice.id.in_(ids[start : start + 500])))
    return len(ids)
