"""Readings of another instrument in a session: how many there are, by pose, and those of one pose."""

from __future__ import annotations

import re
from collections.abc import Sequence

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.tables import MeasuredPose

MAX_SHOWN = 1000
"""Readings of one pose that are shown: more cycles than any test has."""


def count_readings(records: orm.Session, session_ids: Sequence[str]) -> dict[str, int]:
    """Return how many readings each of the sessions has; 0 of one without."""
    counted = (
        sa.select(MeasuredPose.session_id, sa.func.count())
        .where(MeasuredPose.session_id.in_(session_ids))
        .group_by(MeasuredPose.session_id)
    )
    found = dict.fromkeys(session_ids, 0)
    for session_id, count in records.execute(counted):
        found[session_id] = count
    return found


def readings_by_pose(records: orm.Session, session_id: str) -> list[tuple[str, int]]:
    """Return how many readings each pose has, P2 before P10."""
    counted = (
        sa.select(MeasuredPose.pose_id, sa.func.count())
        .where(MeasuredPose.session_id == session_id)
        .group_by(MeasuredPose.pose_id)
    )
    found = [(pose_id, count) for pose_id, count in records.execute(counted)]
    return sorted(found, key=lambda one: _natural(one[0]))


def _natural(text: str) -> list[tuple[int, str]]:
    """Return a key that has numbers in a text by their size."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", text) if part]


def readings_of_pose(records: orm.Session, session_id: str, pose_id: str) -> Sequence[MeasuredPose]:
    """Return the readings of a pose by their cycles, those without one last."""
    chosen = (
        sa.select(MeasuredPose)
        .where(MeasuredPose.session_id == session_id, MeasuredPose.pose_id == pose_id)
        .order_by(MeasuredPose.cycle.is_(None), MeasuredPose.cycle, MeasuredPose.id)
        .limit(MAX_SHOWN)
    )
    return records.scalars(chosen).all()
