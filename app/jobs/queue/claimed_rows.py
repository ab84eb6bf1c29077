"""Claimed rows as jobs. A row that cannot be read fails by itself; the others of its claim are computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import sqlalchemy as sa

from app.jobs.job import Job, TargetQuery
from app.records.outcome import Failure
from app.records.readable import CODE, unreadable_values
from app.records.statements import Rows, Statement
from app.records.tables import Measurement, Session, SessionTarget, Target, target_fields

ADVICE = (
    "Restore the database from a backup. Where the session or a target is damaged, PATCH the session or make it anew; "
    "then retry."
)


_OF_MEASUREMENT = tuple(Measurement.__table__.c.keys())
_OF_SESSION = tuple(Session.__table__.c.keys())
_OF_TARGET = tuple(Target.__table__.c.keys())
_ROW = Statement(
    sa.select(*Measurement.__table__.c, *Session.__table__.c)
    .outerjoin_from(Measurement, Session, Session.id == Measurement.session_id)
    .where(Measurement.id == sa.bindparam("measurement_id"))
)
_SOUGHT = Statement(
    sa.select(SessionTarget.target_id)
    .where(SessionTarget.session_id == sa.bindparam("session_id"))
    .order_by(SessionTarget.position)
)
_TARGET = Statement(sa.select(*Target.__table__.c).where(Target.id == sa.bindparam("target_id")))
Values = dict[str, Any]


def read_jobs(
    rows: Rows, measurement_ids: Sequence[str], claim: str
) -> tuple[tuple[Job, ...], dict[str, tuple[str, ...]]]:
    """Return the jobs of claimed rows in the order given, and the unreadable columns of the rows that are not jobs."""
    targets: dict[str, Values | None] = {}
    jobs: list[Job] = []
    unreadable: dict[str, tuple[str, ...]] = {}
    for measurement_id in measurement_ids:
        found = rows.first(_ROW, measurement_id=measurement_id)
        assert found is not None, "a row that was just claimed"
        of_row = dict(zip(_OF_MEASUREMENT, found, strict=False))
        of_session = dict(zip(_OF_SESSION, found[len(_OF_MEASUREMENT) :], strict=True))
        sought = _sought(rows, of_row)
        for target_id in sought:
            if target_id not in targets:
                targets[target_id] = _read_target(rows, target_id)
        damaged = _damaged(of_row, of_session, sought, targets)
        if damaged:
            unreadable[measurement_id] = damaged
            continue
        jobs.append(
            Job(
                measurement_id=measurement_id,
                claim=claim,
                sha256=of_row["sha256"],
                target_id=of_row["target_id"],
                targets=tuple(TargetQuery(i, fields) for i in sought if (fields := targets[i]) is not None),
                lens=of_session["lens"],
                intrinsics=of_session["intrinsics"],
            )
        )
    return tuple(jobs), unreadable


def unreadable(columns: Sequence[str]) -> Failure:
    """Return why a measurement fails of which `columns` cannot be read; they stay as they are."""
    detail = f"What is stored of this measurement cannot be read: {', '.join(columns)}."
    return Failure(CODE, detail, ADVICE)


def _damaged(
    row: Values, of_session: Values, target_ids: Sequence[str], targets: Mapping[str, Values | None]
) -> tuple[str, ...]:
    """Return what cannot be read of a row, its session and its targets."""
    in_session = [f"session.{column}" for column in unreadable_values(Session, of_session)]
    if of_session["id"] is None:
        in_session = ["session"]
    of_targets = [f"target {target_id}" for target_id in target_ids if targets.get(target_id) is None]
    return (
        *unreadable_values(Measurement, row),
        *in_session,
        *(of_targets if target_ids else ["target_id"]),
    )


def _sought(rows: Rows, row: Values) -> list[str]:
    """Return what a measurement's image is to be searched for: its own target, or all of its session's."""
    if row["seeks_target"]:
        return [target_id for (target_id,) in rows.all(_SOUGHT, session_id=row["session_id"])]
    return [row["target_id"]] if row["target_id"] is not None else []


def _read_target(rows: Rows, target_id: str) -> Values | None:
    """Return a target's fields; None of one that cannot be read, or describes no target."""
    found = rows.first(_TARGET, target_id=target_id)
    if found is None:
        return None
    values = dict(zip(_OF_TARGET, found, strict=True))
    fields = target_fields(Target(**values))
    sound = not unreadable_values(Target, values) and is_target(tuple(fields.items()))
    return fields if sound else None


@lru_cache(maxsize=256)
def is_target(fields: tuple[tuple[str, Any], ...]) -> bool:
    """Say whether fields, as `target_fields` returns them, describe a target that the numerics take."""
    from core.errors import InvalidTarget  # most commands open an installation and need no numerics
    from core.targets import TargetSpec

    try:
        TargetSpec(**dict(fields))
    except InvalidTarget:
        return False
    return True
