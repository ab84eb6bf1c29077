"""Sessions: one camera on one robot, looking at one or more targets; their counts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.blobs.interface import Blobs
from app.errors import InvalidContent
from app.jobs.queue import ALREADY_MEASURED, search_again
from app.records.database import Database
from app.records.ids import is_id, new_id
from app.records.tables import STATUSES, Measurement, Robot, Session, SessionTarget, Target
from app.services.originals import finish_soon, record_removals
from app.services.queries import exists, get_or_raise, page_by_name, visible

Counts = dict[str, int]
COUNTED = (*STATUSES, "duplicates")
"""What a session's measurements are counted as: `failed` those that lack a result which another upload could give,
`duplicates` those of status `failed` that only say where their image was measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NewSession:
    """What a client says about a session."""

    name: str
    target_ids: list[str]
    robot_id: str | None
    lens: dict[str, Any] | None
    intrinsics: dict[str, Any] | None
    conditions: dict[str, Any] | None
    camera_mount: str


@dataclass(frozen=True, slots=True)
class SessionDetail:
    """A session and how far its measurements are."""

    session: Session
    counts: Counts


def create_session(records: orm.Session, new: NewSession) -> SessionDetail:
    """Store a session whose targets and robot exist."""
    session = Session(
        id=new_id("ses"),
        name=new.name,
        robot_id=_existing_robot(records, new.robot_id),
        lens=new.lens,
        intrinsics=new.intrinsics,
        conditions=new.conditions,
        camera_mount=new.camera_mount,
        created_at=datetime.now(UTC),
        targets=_session_targets(records, new.target_ids),
    )
    records.add(session)
    return SessionDetail(session, dict.fromkeys(COUNTED, 0))


def get_session(records: orm.Session, session_id: str) -> SessionDetail:
    """Return a session with its counts."""
    session = get_or_raise(records, Session, session_id)
    return SessionDetail(session, count_measurements(records, [session_id])[session_id])


def list_sessions(
    records: orm.Session, *, name: str | None = None, limit: int, cursor: str | None
) -> tuple[list[SessionDetail], str | None]:
    """Return one page of all sessions the caller's key may see, or of those with this name."""
    rows, next_cursor = page_by_name(records, Session, name=name, limit=limit, cursor=cursor)
    counts = count_measurements(records, [row.id for row in rows])
    return [SessionDetail(row, counts[row.id]) for row in rows], next_cursor


def search_sessions(
    records: orm.Session, *, text: str, robot_id: str | None, page_number: int, size: int
) -> tuple[list[SessionDetail], int]:
    """Return a page of the sessions whose name holds `text`, newest first, and how many there are in all."""
    which = list(visible(Session))
    if text:
        which.append(Session.name.icontains(text, autoescape=True))
    if robot_id:
        which.append(Session.robot_id == robot_id)
    total = records.scalar(sa.select(sa.func.count()).select_from(Session).where(*which)) or 0
    start = (max(page_number, 1) - 1) * size
    rows = records.scalars(
        sa.select(Session).where(*which).order_by(Session.id.desc()).limit(size).offset(start)
    ).all()
    counts = count_measurements(records, [row.id for row in rows])
    return [SessionDetail(row, counts[row.id]) for row in rows], total


def update_session(records: orm.Session, session_id: str, changes: Mapping[str, Any]) -> SessionDetail:
    """Change the fields named in `changes`.

    Results stay as they are until they are computed again: at once where `target_ids` change, else on request. No
    change touches commanded poses, which are those of the flange in the base whatever the camera is mounted on.
    """
    session = get_or_raise(records, Session, session_id, lock=True)
    for field in ("name", "lens", "intrinsics", "conditions", "camera_mount"):
        if field in changes:
            setattr(session, field, changes[field])
    if "robot_id" in changes:
        session.robot_id = _existing_robot(records, changes["robot_id"])
    if "target_ids" in changes:
        _change_targets(records, session, changes["target_ids"])
    records.flush()
    return SessionDetail(session, count_measurements(records, [session_id])[session_id])


def delete_session(
    database: Database,
    blobs: Blobs,
    session_id: str,
    *,
    unless: Callable[[orm.Session], bool] | None = None,
) -> bool:
    """Remove a session, its poses, measurements and results, and the originals nobody else holds.

    Queued work goes with its rows; a job that runs just now finds its row gone and its result is dropped. Files that
    cannot be removed now are removed later. `unless` is asked once no other writer can add to the session; where it
    says so, nothing is removed. Return whether the session was.
    """
    with database.write() as records:
        # No upload adds a row between record and deletion.
        session = get_or_raise(records, Session, session_id, lock=True)
        if unless is not None and unless(records):
            return False
        originals = record_removals(records, Measurement.session_id == session_id)
        records.delete(session)
    finish_soon(database, blobs, originals)
    return True


def count_measurements(records: orm.Session, session_ids: Sequence[str]) -> dict[str, Counts]:
    """Return how many measurements of each session stand where."""
    counts = {session_id: dict.fromkeys(COUNTED, 0) for session_id in session_ids}
    for session_id, counted in _count(records, Measurement.session_id.in_(session_ids)).items():
        counts[session_id] = counted
    return counts


def count_all_measurements(records: orm.Session) -> Counts:
    """Return how many measurements of all sessions together stand where."""
    of_sessions = _count(records).values()
    return {name: sum(counts[name] for counts in of_sessions) for name in COUNTED}


def _count(records: orm.Session, *which: sa.ColumnElement[bool]) -> dict[str, Counts]:
    counts: defaultdict[str, Counts] = defaultdict(lambda: dict.fromkeys(COUNTED, 0))
    number = sa.func.count()
    for session_id, status, count in records.execute(
        sa.select(Measurement.session_id, Measurement.status, number)
        .where(*which)
        .group_by(Measurement.session_id, Measurement.status)
    ):
        counts[session_id][status] = count
    # A question of its own: an index answers the one above, and leads this one to the few rows that failed.
    for session_id, count in records.execute(
        sa.select(Measurement.session_id, number)
        .where(*which, Measurement.status == "failed", Measurement.failure_code == ALREADY_MEASURED.code)
        .group_by(Measurement.session_id)
    ):
        counts[session_id]["failed"] -= count
        counts[session_id]["duplicates"] = count
    return counts


def _existing_robot(records: orm.Session, robot_id: str | None) -> str | None:
    if robot_id is not None and not exists(records, Robot, robot_id, keep=True):
        raise InvalidContent(
            "There is no such robot.",
            "Make the robot first, or leave robot_id away.",
            code="referenced_robot_not_found",
            errors=[("robot_id", "names no robot")],
        )
    return robot_id


def _session_targets(records: orm.Session, target_ids: Sequence[str]) -> list[SessionTarget]:
    if len(set(target_ids)) != len(target_ids):
        raise InvalidContent(
            "A target is named twice.", errors=[("target_ids", "names a target more than once")]
        )
    known = set(
        records.scalars(
            sa.select(Target.id)
            .where(Target.id.in_([i for i in target_ids if is_id(i)]), *visible(Target))
            .with_for_update(read=True, key_share=True)  # none is deleted before this is committed
        )
    )
    if not known.issuperset(target_ids):
        raise InvalidContent(
            "There is no such target.",
            "Make the target first; every id in target_ids must exist.",
            code="referenced_target_not_found",
            errors=[
                (f"target_ids.{position}", "names no target")
                for position, target_id in enumerate(target_ids)
                if target_id not in known
            ],
        )
    return [
        SessionTarget(position=position, target_id=target_id) for position, target_id in enumerate(target_ids)
    ]


def _change_targets(records: orm.Session, session: Session, target_ids: Sequence[str]) -> None:
    """Replace a session's targets; images of which a measurement lost its target are searched again."""
    targets = _session_targets(records, target_ids)
    before = {target.target_id for target in session.targets}
    session.targets.clear()
    records.flush()
    session.targets.extend(targets)
    records.flush()
    if before != set(target_ids):
        search_again(records, session.id, target_ids, with_new=not before.issuperset(target_ids))
