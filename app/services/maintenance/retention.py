"""Retention: what is older than `GRIDPOSE_RETENTION_DAYS` is removed, originals and sessions together.

A session is as old as the newest thing in it: its last image, commanded pose or measured pose, by the moments their
ids were made; one that was restored from an archive is at most as old as its restore, by the audit trail. It goes as a
whole, as if somebody had deleted it, so that no result is left whose image is gone and no client sends an image again
that was removed on purpose. One with images that are not computed yet stays.

A clock that jumps ahead by years must not remove everything. The clock is trusted once it has agreed with itself for a
day: over runs that follow one another by at most `MAX_GAP`, and within one process by the time that has passed in
truth. A jump by more begins the day anew, so that whoever looks after the clock has that day. The beginning of the
agreement is kept in the data folder, since a workshop's PC may be switched off every night.

A clock that goes ahead at once may have been behind until then, so that everything made before looks older than it is.
Nothing made before such a jump goes until it is old enough counted from the jump; the jump is kept as well.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import sqlalchemy as sa
from sqlalchemy import orm

from app.blobs.durable import write_durably
from app.errors import NotFound
from app.logs import Logger
from app.records.activity import Activity, acting
from app.records.ids import is_id, least_id, moment_of
from app.records.tables import AuditEntry, MeasuredPose, Measurement, Pose, Session
from app.services.installation.context import ServiceContext
from app.services.sessions import delete_session

MIN_AGREEMENT = timedelta(days=1)
"""How long the clock must have agreed with itself before anything is removed."""
MAX_GAP = timedelta(days=8)
"""Longest time between two runs that the clock may have gone on by itself: a holiday week, switched off."""
MAX_STEP = timedelta(minutes=5)
"""Largest difference between the clock and the time passed in truth that setting the clock right explains."""
STATE = "retention.json"

log = Logger(__name__)


def elapsed_s() -> float:
    """Return seconds that no setting of the clock changes; where the system can, those asleep are counted."""
    if hasattr(time, "CLOCK_BOOTTIME"):
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()


@dataclass(frozen=True, slots=True)
class Expired:
    """A session that was removed, and how old the newest thing in it was."""

    session_id: str
    name: str
    newest: datetime


def _log(expired: Expired) -> None:
    log.info("session_expired", session_id=expired.session_id, newest=expired.newest.isoformat())


@dataclass(frozen=True, slots=True)
class Agreement:
    """Since when the clock has agreed with itself, what it last said, and what it said after it last jumped ahead."""

    since: datetime
    last: datetime
    jumped_at: datetime | None = None


class Retention:
    """Applies the retention of one installation; made once in a process, run every so often."""

    def __init__(self, installation: ServiceContext) -> None:
        self._installation = installation
        self._path = installation.settings.data_dir / STATE
        self._before: tuple[datetime, float] | None = None

    def run(
        self, now: datetime, elapsed: float, *, stopped: Callable[[], bool] = lambda: False
    ) -> list[Expired]:
        """Remove what is too old at `now`, aware; return what was removed. `elapsed` is `elapsed_s()`.

        Raises ServiceError where a deletion cannot be finished now; what was removed until then stays removed.
        """
        days = self._installation.settings.retention_days
        if days is None:
            return []
        agreement = self._agree(now, elapsed)
        if now - agreement.since < MIN_AGREEMENT:
            return []
        if agreement.jumped_at is not None and now - agreement.jumped_at < timedelta(days=days):
            # What was made before the jump is as old as the jump at most; what was made since is younger.
            return []
        return apply_retention(self._installation, now, stopped=stopped)

    def _agree(self, now: datetime, elapsed: float) -> Agreement:
        """Return the clock's agreement with itself, this run included, and keep it."""
        stored = _read(self._path)
        agreement = Agreement(now, now)
        if stored is not None:
            gap = now - stored.last
            step = timedelta(0)
            if self._before is not None:
                step = (now - self._before[0]) - timedelta(seconds=elapsed - self._before[1])
            # One that lies ahead of the clock was itself a mistake that has been set right since.
            jumped_at = min(stored.jumped_at, now) if stored.jumped_at is not None else None
            if step > MAX_STEP or gap > MAX_GAP:
                jumped_at = now
            if abs(step) > MAX_STEP or not timedelta(0) <= gap <= MAX_GAP or stored.since > stored.last:
                log.warning(
                    "retention_waits",
                    reason="the clock was set",
                    before=str(stored.last),
                    now=str(now),
                    jumped_at=str(jumped_at) if jumped_at is not None else None,
                )
                agreement = Agreement(now, now, jumped_at)
            else:
                agreement = Agreement(stored.since, now, jumped_at)
        self._before = (now, elapsed)
        _write(self._path, agreement)
        return agreement


def apply_retention(
    installation: ServiceContext, now: datetime, *, stopped: Callable[[], bool] = lambda: False
) -> list[Expired]:
    """Remove the sessions that are too old at `now`, whatever the clock did before; return them, oldest first.

    A session of unknown age, with an id that is not ours, stays.
    """
    days = installation.settings.retention_days
    if days is None:
        return []
    limit = now - timedelta(days=days)
    with installation.database.read() as records:
        # Ids are in the order of time: the first one that is young enough ends the search.
        known = records.execute(sa.select(Session.id, Session.name).order_by(Session.id)).all()
    removed: list[Expired] = []
    restored: frozenset[str] | None = None
    for session_id, name in known:
        if stopped():
            break
        made = _moment(session_id)
        if made is not None and made >= limit:
            break
        with installation.database.read() as records:
            newest = _newest(records, session_id)
            if newest is None:
                log.warning("session_not_expired", session_id=session_id, reason="an id in it is damaged")
                continue
            if newest >= limit or _is_pending(records, session_id):
                continue
            if restored is None:  # read for the first that is old, which few rounds have
                restored = _restored_since(records, limit)
            if session_id in restored:
                continue
        if _remove(installation, session_id, limit):
            removed.append(Expired(session_id, name, newest))
            _log(removed[-1])
    return removed


def _remove(installation: ServiceContext, session_id: str, limit: datetime) -> bool:
    """Delete a session unless something came to it meanwhile, with an audit entry; say whether it was deleted."""
    activity = Activity(actor="service", action="expire_session", object_ids=[session_id])

    def came_back(records: orm.Session) -> bool:
        newest = _newest(records, session_id)
        came = newest is None or newest >= limit or _is_pending(records, session_id)
        activity.audited = not came
        return came

    try:
        with acting(activity):
            return delete_session(installation.database, installation.blobs, session_id, unless=came_back)
    except NotFound:
        return False  # somebody else deleted it


def _moment(row_id: str) -> datetime | None:
    """Return when an id was made; None where it is not one of ours."""
    try:
        return moment_of(row_id) if is_id(row_id) else None
    except OverflowError:
        return None


def _newest(records: orm.Session, session_id: str) -> datetime | None:
    """Return when the newest thing of a session came, None where its id says nothing; each is one step of an index."""
    ids: Sequence[str | None] = [
        session_id,
        *(
            records.scalar(sa.select(sa.func.max(table.id)).where(table.session_id == session_id))
            for table in (Measurement, Pose, MeasuredPose)
        ),
    ]
    moments = [_moment(row_id) for row_id in ids if row_id is not None]
    known = [moment for moment in moments if moment is not None]
    return max(known) if len(known) == len(moments) else None


def _restored_since(records: orm.Session, moment: datetime) -> frozenset[str]:
    """Return the sessions that somebody restored from archives since then, on purpose and to look at."""
    entries = records.scalars(
        sa.select(AuditEntry.object_ids).where(
            AuditEntry.id >= least_id("aud", moment), AuditEntry.action == "restore_session"
        )
    )
    return frozenset(each for object_ids in entries for each in object_ids)


def _is_pending(records: orm.Session, session_id: str) -> bool:
    return bool(
        records.scalar(
            sa.select(
                sa.exists().where(
                    Measurement.session_id == session_id, Measurement.status.in_(("queued", "running"))
                )
            )
        )
    )


def _read(path: Path) -> Agreement | None:
    """Return the stored agreement, or None if it is missing or unreadable: then it begins anew."""
    try:
        stored = json.loads(path.read_bytes())
        since, last = (datetime.fromisoformat(stored[name]) for name in ("since", "last"))
        jumped = stored.get("jumped_at")
        jumped_at = datetime.fromisoformat(jumped) if jumped is not None else None
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError, AttributeError):
        log.warning("retention_waits", reason="its file cannot be read", path=path.name)
        return None
    if any(moment is not None and moment.tzinfo is None for moment in (since, last, jumped_at)):
        return None
    return Agreement(since, last, jumped_at)


def _write(path: Path, agreement: Agreement) -> None:
    """Keep the agreement; the file appears whole or not at all."""
    values = {"since": agreement.since, "last": agreement.last, "jumped_at": agreement.jumped_at}
    text = json.dumps({name: value.isoformat() for name, value in values.items() if value is not None})
    try:
        write_durably(path, text.encode("ascii"))
    except OSError as error:
        # A full disk is what removing old sessions helps against; but then nothing shows that the clock agrees.
        log.warning("retention_waits", reason=str(error.strerror))
