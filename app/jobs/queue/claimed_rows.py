"""Claimed rows as jobs. A row that cannot be read fails by itself; the others of its claim are computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.jobs.queue.interface import Job, TargetQuery
from app.records.codec import Failure
from app.records.readable import CODE, unreadable_columns
from app.records.tables import Measurement, Session, SessionTarget, Target, target_fields
from core.errors import InvalidTarget
from core.targets import TargetSpec

ADVICE = (
    "Restore the database from a backup. Where the session or a target is damaged, PATCH the session or make it anew; "
    "then retry."
)


def read_jobs(
    session: orm.Session, measurement_ids: Sequence[str], claim: str
) -> tuple[tuple[Job, ...], dict[str, tuple[str, ...]]]:
    """Return the jobs of claimed rows in the order given, and the unreadable columns of the rows that are not jobs."""
    rows = {
        row.id: (row, of_session)
        for row, of_session in session.execute(
            sa.select(Measurement, Session)
            .outerjoin(Session, Session.id == Measurement.session_id)
            .options(orm.raiseload(Session.targets))
            .where(Measurement.id.in_(measurement_ids))
            .execution_options(populate_existing=True)
        )
    }
    sessions = {row.session_id: of_session for row, of_session in rows.values()}
    damaged_sessions = {i: _unreadable_session(of_session) for i, of_session in sessions.items()}
    sought = _targets_of(session, [row for row, _ in rows.values()])
    targets = _read_targets(session, {target_id for ids in sought.values() for target_id in ids})
    jobs: list[Job] = []
    unreadable: dict[str, tuple[str, ...]] = {}
    for measurement_id in measurement_ids:
        row, of_session = rows[measurement_id]
        damaged = _damaged(row, damaged_sessions[row.session_id], sought[measurement_id], targets)
        if damaged:
            unreadable[measurement_id] = damaged
            continue
        jobs.append(
            Job(
                measurement_id=row.id,
                claim=claim,
                sha256=row.sha256,
                target_id=row.target_id,
                targets=tuple(
                    TargetQuery(i, fields) for i in sought[row.id] if (fields := targets[i]) is not None
                ),
                lens=of_session.lens,
                intrinsics=of_session.intrinsics,
            )
        )
    return tuple(jobs), unreadable


def unreadable(columns: Sequence[str]) -> Failure:
    """Return why a measurement fails of which `columns` cannot be read; they stay as they are."""
    detail = f"What is stored of this measurement cannot be read: {', '.join(columns)}."
    return Failure(CODE, detail, ADVICE)


def _damaged(
    row: Measurement,
    of_session: tuple[str, ...],
    target_ids: Sequence[str],
    targets: Mapping[str, dict[str, Any] | None],
) -> tuple[str, ...]:
    """Return what cannot be read of a row, its session and its targets."""
    of_targets = [f"target {target_id}" for target_id in target_ids if targets.get(target_id) is None]
    return (*unreadable_columns(row), *of_session, *(of_targets if target_ids else ["target_id"]))


def _unreadable_session(session: Session | None) -> tuple[str, ...]:
    if session is None:
        return ("session",)
    return tuple(f"session.{column}" for column in unreadable_columns(session))


def _targets_of(session: orm.Session, rows: Sequence[Measurement]) -> dict[str, list[str]]:
    """Return what each measurement's image is to be searched for: its own target, or all of its session's."""
    seeking = {row.session_id for row in rows if row.seeks_target}
    of_session: dict[str, list[str]] = {}
    if seeking:
        for session_id, target_id in session.execute(
            sa.select(SessionTarget.session_id, SessionTarget.target_id)
            .where(SessionTarget.session_id.in_(seeking))
            .order_by(SessionTarget.session_id, SessionTarget.position)
        ):
            of_session.setdefault(session_id, []).append(target_id)
    return {
        row.id: of_session.get(row.session_id, [])
        if row.seeks_target
        else [row.target_id]
        if row.target_id is not None
        else []
        for row in rows
    }


def _read_targets(session: orm.Session, target_ids: set[str]) -> dict[str, dict[str, Any] | None]:
    """Return each target's fields; None of one that cannot be read, or describes no target."""
    targets: dict[str, dict[str, Any] | None] = {}
    for target in session.scalars(sa.select(Target).where(Target.id.in_(target_ids))):
        fields = target_fields(target)
        sound = not unreadable_columns(target) and is_target(tuple(fields.items()))
        targets[target.id] = fields if sound else None
    return targets


@lru_cache(maxsize=256)
def is_target(fields: tuple[tuple[str, Any], ...]) -> bool:
    """Say whether fields, as `target_fields` returns them, describe a target that the numerics take."""
    try:
        TargetSpec(**dict(fields))
    except InvalidTarget:
        return False
    return True
