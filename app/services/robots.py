"""Robots: their nominal Denavit-Hartenberg parameters."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import Robot


def create_robot(
    session: orm.Session, *, name: str, joints: list[dict[str, Any]], repeatability_mm: float | None
) -> Robot:
    """Store a robot."""
    robot = Robot(
        id=new_id("rob"),
        name=name,
        joints=joints,
        repeatability_mm=repeatability_mm,
        created_at=datetime.now(UTC),
    )
    session.add(robot)
    return robot


def list_robots(
    session: orm.Session, *, limit: int, cursor: str | None
) -> tuple[Sequence[Robot], str | None]:
    """Return one page of all robots."""
    return page(session, sa.select(Robot), Robot.id, limit=limit, cursor=cursor)
