"""Robots: their nominal Denavit-Hartenberg parameters, and the input of a plan of poses."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict, InvalidContent
from app.records.database import Database
from app.records.ids import new_id
from app.records.tables import Robot, Session, Target, target_fields
from app.services.plausibility import MAX_PARALLEL
from app.services.queries import (
    MAX_NAMED,
    exists,
    get_or_raise,
    lock_for_deletion,
    require_readable,
)

MIN_DETERMINANT = 1e-6
QUARTER_DEG = 90.0


def create_robot(records: orm.Session, fields: Mapping[str, Any]) -> Robot:
    """Store a robot; of its joints what is known of them.

    Raises InvalidContent if names are not unique, a lower limit is not below its upper limit, β is not of nearly
    parallel axes, or the coupling does not fit the joints.
    """
    robot = Robot(id=new_id("rob"), created_at=datetime.now(UTC), **_columns(fields))
    robot.joint_coupling = _coupling(robot.joint_coupling, len(robot.joints))
    records.add(robot)
    return robot


def update_robot(records: orm.Session, robot_id: str, changes: Mapping[str, Any]) -> Robot:
    """Change the fields named in `changes`; analyses of the robot's sessions are computed anew from them.

    Raises NotFound, and InvalidContent as `create_robot` does.
    """
    robot = get_or_raise(records, Robot, robot_id, lock=True)
    for field, value in _columns(changes).items():
        setattr(robot, field, value)
    robot.joint_coupling = _coupling(robot.joint_coupling, len(robot.joints))
    records.flush()
    return robot


def _columns(fields: Mapping[str, Any]) -> dict[str, Any]:
    columns = dict(fields)
    if "joints" in columns:
        _check(columns["joints"])
        columns["joints"] = [
            {key: value for key, value in joint.items() if value is not None} for joint in columns["joints"]
        ]
    return columns


def _coupling(coupling: list[list[float]] | None, joints: int) -> list[list[float]] | None:
    """Return the coupling; None for ones alone, which couple nothing."""
    if coupling is None:
        return None
    fits = len(coupling) == joints and all(len(row) == joints for row in coupling)
    if not fits or abs(np.linalg.det(np.array(coupling))) < MIN_DETERMINANT:
        raise InvalidContent(
            f"joint_coupling is not an invertible matrix of {joints} rows and columns.",
            "Send ones on the diagonal, and in the row of a joint that follows another the share of its angle; null "
            "where no joint does.",
            code="invalid_joint_coupling",
            errors=[("joint_coupling", "must be n x n for n joints, and invertible")],
        )
    return None if coupling == np.eye(joints).tolist() else coupling


def _check(joints: Sequence[Mapping[str, Any]]) -> None:
    errors: list[tuple[str, str]] = []
    names: set[str] = set()
    for place, joint in enumerate(joints):
        name, lower, upper = (joint.get(key) for key in ("name", "minimum_deg", "maximum_deg"))
        if name is not None and name in names:
            errors.append((f"joints.{place}.name", "is the name of another joint"))
        if name is not None:
            names.add(name)
        if (lower is None) != (upper is None):
            missing = "minimum_deg" if lower is None else "maximum_deg"
            errors.append((f"joints.{place}.{missing}", "is missing: limits come together"))
        elif lower is not None and upper is not None and not lower < upper:
            held = (
                "; give a joint that is held no limits, and its angle with each pose"
                if lower == upper
                else ""
            )
            errors.append((f"joints.{place}.maximum_deg", f"must be above minimum_deg{held}"))
        if joint.get("beta_deg") and (place == len(joints) - 1 or not _nearly_parallel(joint)):
            errors.append(
                (f"joints.{place}.beta_deg", "is of a joint whose axis is near parallel to the next one's")
            )
    if errors:
        raise InvalidContent(
            "The joints' names, limits or turns are not valid.",
            "Give every joint a name of its own, or none; minimum_deg below maximum_deg, or neither; beta_deg where "
            "alpha_deg is within 11.5° of 0 or of half a turn, and not with the last joint.",
            code="invalid_joints",
            errors=errors,
        )


def _nearly_parallel(joint: Mapping[str, Any]) -> bool:
    turns = (math.radians(joint[name]) for name in ("alpha_deg", "beta_deg"))
    return all(abs(math.sin(turn)) < MAX_PARALLEL for turn in turns) and abs(joint["beta_deg"]) < QUARTER_DEG


def delete_robot(records: orm.Session, robot_id: str) -> None:
    """Delete a robot that no session names. Raises NotFound, Conflict."""
    robot = lock_for_deletion(records, Robot, robot_id)
    sessions = records.scalars(
        sa.select(Session.id).where(Session.robot_id == robot_id).order_by(Session.id).limit(MAX_NAMED)
    ).all()
    if sessions:
        raise Conflict(
            f"Sessions name the robot: {', '.join(sessions)}.",
            "Change the sessions' robot_id (PATCH /v1/sessions/{session_id}, `gridpose sessions change`), or delete "
            "the sessions.",
            code="robot_in_use",
            errors=[("session_id", session_id) for session_id in sessions],
        )
    records.delete(robot)


def read_plan(database: Database, robot_id: str, target_id: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the robot's `joints` and `joint_coupling`, and the target's fields.

    Raises NotFound for the robot, InvalidContent for the target, RowUnreadable for either.
    """
    with database.read() as records:
        robot = get_or_raise(records, Robot, robot_id)
        if not exists(records, Target, target_id):
            raise InvalidContent(
                "There is no such target.",
                "Make the target first.",
                code="referenced_target_not_found",
                errors=[("target_id", "names no target")],
            )
        target = get_or_raise(records, Target, target_id)
        require_readable(robot)
        require_readable(target)
        return {"joints": robot.joints, "joint_coupling": robot.joint_coupling}, target_fields(target)


def limits_setting(database: Database, session_id: str) -> str:
    """Return the joint limits of a session's robot as analyses take them: pairs of degrees as JSON.

    A pair has null where the robot states no limit; a session without a robot gives no pair. Raises NotFound for the
    session, RowUnreadable for its robot.
    """
    with database.read() as records:
        session = get_or_raise(records, Session, session_id)
        if session.robot_id is None:
            return "[]"
        robot = get_or_raise(records, Robot, session.robot_id)
        require_readable(robot)
        return json.dumps([(joint.get("minimum_deg"), joint.get("maximum_deg")) for joint in robot.joints])


def read_correction(
    records: orm.Session, robot_id: str, session_ids: Sequence[str]
) -> list[tuple[float, float]]:
    """Return the limits of the robot's joints, degrees, infinite where none are stated, for commands of its sessions.

    Raises NotFound for the robot, InvalidContent for a session that is not there or is of another robot.
    """
    robot = get_or_raise(records, Robot, robot_id)
    require_readable(robot)
    for session_id in session_ids:
        if not exists(records, Session, session_id):
            raise InvalidContent(
                "There is no such session.",
                "Name a session of this robot.",
                code="referenced_session_not_found",
                errors=[("session_id", f"{session_id} names no session")],
            )
        if get_or_raise(records, Session, session_id).robot_id != robot_id:
            raise Conflict(
                "The session is not of this robot.",
                "Name a session of this robot, or give the session its robot (PATCH /v1/sessions/{session_id}).",
                code="session_of_another_robot",
                errors=[("session_id", f"{session_id} is of another robot, or of none")],
            )
    return [
        (
            -math.inf if joint.get("minimum_deg") is None else joint["minimum_deg"],
            math.inf if joint.get("maximum_deg") is None else joint["maximum_deg"],
        )
        for joint in robot.joints
    ]
