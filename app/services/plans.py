"""What a plan is made of: a stored robot and a stored target."""

from __future__ import annotations

from typing import Any

from sqlalchemy import orm

from app.errors import InvalidContent
from app.records.tables import Robot, Target, target_fields
from app.services.lookup import exists, find


def read_plan(
    records: orm.Session, robot_id: str, target_id: str
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return the robot's joints and the target's fields.

    Raises NotFound for the robot, InvalidContent for the target.
    """
    robot = find(records, Robot, robot_id)
    if not exists(records, Target, target_id):
        raise InvalidContent(
            "There is no such target.",
            "Make the target first.",
            code="target_unknown",
            errors=[("target_id", "names no target")],
        )
    return robot.joints, target_fields(find(records, Target, target_id))
