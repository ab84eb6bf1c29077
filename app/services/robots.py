"""Robots: their nominal Denavit-Hartenberg parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import InvalidContent
from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import Robot


def create_robot(
    session: orm.Session, *, name: str, joints: list[dict[str, Any]], repeatability_mm: float | None
) -> Robot:
    """Store a robot; of its joints what is known of them.

    Raises InvalidContent where names are not unique, or limits are none.
    """
    _check(joints)
    robot = Robot(
        id=new_id("rob"),
        name=name,
        joints=[{key: value for key, value in joint.items() if value is not None} for joint in joints],
        repeatability_mm=repeatability_mm,
        created_at=datetime.now(UTC),
    )
    session.add(robot)
    return robot


def _check(joints: Sequence[Mapping[str, Any]]) -> None:
    errors: list[tuple[str, str]] = []
    names: set[str] = set()
    for place, joint in enumerate(joints):
        name, lower, upper = (joint.get(key) for key in ("name", "lower_deg", "upper_deg"))
        if name is not None and name in names:
            errors.append((f"joints.{place}.name", "is the name of another joint"))
        if name is not None:
            names.add(name)
        if (lower is None) != (upper is None):
            missing = "lower_deg" if lower is None else "upper_deg"
            errors.append((f"joints.{place}.{missing}", "is missing: limits come together"))
        elif lower is not None and upper is not None and not lower < upper:
            errors.append((f"joints.{place}.upper_deg", "must be above lower_deg"))
    if errors:
        raise InvalidContent(
            "The joints' names or limits are not valid.",
            "Give every joint a name of its own, or none; lower_deg below upper_deg, or neither.",
            code="invalid_joints",
            errors=errors,
        )


def list_robots(
    session: orm.Session, *, limit: int, cursor: str | None
) -> tuple[Sequence[Robot], str | None]:
    """Return one page of all robots."""
    return page(session, sa.select(Robot), Robot.id, limit=limit, cursor=cursor)
