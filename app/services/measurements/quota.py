"""Daily upload quota of a key: counted in the transaction that stores an image, refused beyond the quota."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import sqlalchemy as sa

from app.errors import QuotaExceeded
from app.records.activity import current_activity
from app.records.database import Database
from app.records.statements import Rows, Statement
from app.records.tables import ApiKey

_COUNT = Statement(
    sa.update(ApiKey)
    .where(ApiKey.id == sa.bindparam("key"), ApiKey.bytes_per_day.is_not(None))
    .values(
        quota_bytes=sa.case((ApiKey.quota_day == sa.bindparam("day"), ApiKey.quota_bytes), else_=0)
        + sa.bindparam("size", type_=sa.BigInteger()),
        quota_day=sa.bindparam("day"),
    )
    .returning(ApiKey.bytes_per_day, ApiKey.quota_bytes)
)


_USE = Statement(
    sa.select(ApiKey.bytes_per_day, ApiKey.quota_day, ApiKey.quota_bytes).where(
        ApiKey.id == sa.bindparam("key")
    )
)


def count_upload(rows: Rows, size: int) -> None:
    """Count `size` bytes for the caller's key; raises QuotaExceeded where its day has no room for them.

    The row is locked until the commit, so that uploads at the same time count one after the other; where the
    transaction is rolled back, nothing is counted. Deleting an image gives nothing back.
    """
    activity = current_activity()
    if activity is None or not activity.has_quota:
        return
    row = rows.first(_COUNT, key=activity.key_id, day=day_of(datetime.now(UTC)), size=size)
    if row is not None:
        bytes_per_day, quota_bytes = row
        check_quota(bytes_per_day, quota_bytes - size, size)


def read_use(database: Database, key_id: str) -> tuple[int | None, int]:
    """Return what a key may send in a day, None without a quota, and what it has sent since midnight UTC."""
    with database.read_rows() as rows:
        row = rows.first(_USE, key=key_id)
    if row is None or row[0] is None:
        return None, 0
    bytes_per_day, quota_day, quota_bytes = row
    return bytes_per_day, quota_bytes if quota_day == day_of(datetime.now(UTC)) else 0


def check_quota(bytes_per_day: int | None, used: int, size: int) -> None:
    """Raise QuotaExceeded where `size` bytes more would be beyond the quota."""
    if bytes_per_day is None or used + size <= bytes_per_day:
        return
    now = datetime.now(UTC)
    midnight = now.replace(hour=0, minute=0, second=0, microsecond=0) + timedelta(days=1)
    raise QuotaExceeded(
        f"The key may send {bytes_per_day} bytes a day; {used} are used, and {size} more do not fit.",
        "Send it again after midnight UTC, or let an administrator raise bytes_per_day of the key.",
        retry_after_s=int((midnight - now).total_seconds()) + 1,
    )


def bytes_today(key: ApiKey) -> int | None:
    """Return what a key with a quota has sent since midnight UTC, None for one without."""
    if key.bytes_per_day is None:
        return None
    return key.quota_bytes if key.quota_day == day_of(datetime.now(UTC)) else 0


def day_of(moment: datetime) -> str:
    """Return a moment's day in UTC, YYYY-MM-DD."""
    return moment.astimezone(UTC).date().isoformat()
