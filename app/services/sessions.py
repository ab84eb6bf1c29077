"""Sessions: one camera on one robot, looking at one or more targets."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.blobs.local import LocalBlobs
from app.errors import InvalidContent
from app.jobs.row_queue import ALREADY_MEASURED
from app.records.database import Database
from app.records.ids import is_id, new_id
from app.records.pagination import page
from app.records.tables import STATUSES, Measurement, Robot, Session, SessionTarget, Target
from app.services.lookup import find
from app.services.originals import remove_unreferenced

Counts = dict[str, int]
COUNTED = (*STATUSES, "already_measured")
"""What a session's measurements are counted as: `failed` those that lack a result which another upload could give,
`already_measured` those of status `failed` that only say where their image was measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NewSession:
    """What a client says about a session."""

    name: str
    target_ids: list[str]
    robot_id: str | None
    lens: dict[str, Any] | None
    intrinsics: dict[str, Any] | None


@dataclass(frozen=True, slots=True)
class SessionView:
    """A session and how far its measurements are."""

    session: Session
    counts: Counts


def create_session(records: orm.Session, new: NewSession) -> SessionView:
    """Store a session whose targets and robot exist."""
    session = Session(
        id=new_id("ses"),
        name=new.name,
        robot_id=_existing_robot(records, new.robot_id),
        lens=new.lens,
        intrinsics=new.intrinsics,
        created_at=datetime.now(UTC),
        targets=_session_targets(records, new.target_ids),
    )
    records.add(session)
    return SessionView(session, dict.fromkeys(COUNTED, 0))


def get_session(records: orm.Session, session_id: str) -> SessionView:
    """Return a session with its counts."""
    session = find(records, Session, session_id)
    return SessionView(session, count_measurements(records, [session_id])[session_id])


def list_sessions(
    records: orm.Session, *, limit: int, cursor: str | None
) -> tuple[list[SessionView], str | None]:
    """Return one page of all sessions."""
    rows, next_cursor = page(records, sa.select(Session), Session.id, limit=limit, cursor=cursor)
    counts = count_measurements(records, [row.id for row in rows])
    return [SessionView(row, counts[row.id]) for row in rows], next_cursor


def change_session(records: orm.Session, session_id: str, changes: Mapping[str, Any]) -> SessionView:
    """Change the fields named in `changes`; results already there stay as they are until they are retried."""
    session = find(records, Session, session_id, lock=True)
    for field in ("name", "lens", "intrinsics"):
        if field in changes:
            setattr(session, field, changes[field])
    if "robot_id" in changes:
        session.robot_id = _existing_robot(records, changes["robot_id"])
    if "target_ids" in changes:
        _change_targets(records, session, changes["target_ids"])
    records.flush()
    return SessionView(session, count_measurements(records, [session_id])[session_id])


def delete_session(database: Database, blobs: LocalBlobs, session_id: str) -> None:
    """Remove a session, its poses, measurements and results, and the originals nobody else holds.

    Queued work goes with its rows; a job that runs just now finds its row gone and its result is dropped.
    """
    with database.write() as records:
        session = find(records, Session, session_id)
        originals = records.scalars(
            sa.select(Measurement.sha256).where(Measurement.session_id == session_id).distinct()
        ).all()
        records.delete(session)
    for sha256 in originals:
        remove_unreferenced(database, blobs, sha256)


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
        counts[session_id]["already_measured"] = count
    return counts


def _existing_robot(records: orm.Session, robot_id: str | None) -> str | None:
    if robot_id is not None and (not is_id(robot_id) or records.get(Robot, robot_id) is None):
        raise InvalidContent(
            "There is no such robot.",
            "Make the robot first, or leave robot_id away.",
            code="robot_unknown",
            errors=[("robot_id", "names no robot")],
        )
    return robot_id


def _session_targets(records: orm.Session, target_ids: Sequence[str]) -> list[SessionTarget]:
    if len(set(target_ids)) != len(target_ids):
        raise InvalidContent(
            "A target is named twice.", errors=[("target_ids", "names a target more than once")]
        )
    known = set(
        records.scalars(sa.select(Target.id).where(Target.id.in_([i for i in target_ids if is_id(i)])))
    )
    if not known.issuperset(target_ids):
        raise InvalidContent(
            "There is no such target.",
            "Make the target first; every id in target_ids must exist.",
            code="target_unknown",
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
    targets = _session_targets(records, target_ids)
    used = set(
        records.scalars(
            sa.select(Measurement.target_id)
            .where(Measurement.session_id == session.id, Measurement.target_id.is_not(None))
            .distinct()
        )
    )
    if not used.issubset(target_ids):
        raise InvalidContent(
            "Measurements of this session refer to a target that would be taken away.",
            "Keep every target that has measurements.",
            code="target_in_use",
            errors=[("target_ids", "leaves out a target that has measurements")],
        )
    session.targets.clear()
    records.flush()
    session.targets.extend(targets)
