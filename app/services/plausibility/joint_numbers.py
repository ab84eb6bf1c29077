"""Joint angles as many as the session's robot has joints: what is stated of poses and images is checked as it comes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import sqlalchemy as sa

from app.errors import InvalidContent
from app.records.statements import Rows, Statement
from app.records.tables import Robot, Session

MAX_ERRORS = 100
_JOINTS = Statement(
    sa.select(Robot.joints)
    .join(Session, Session.robot_id == Robot.id)
    .where(Session.id == sa.bindparam("session_id"))
)


def require_joints(rows: Rows, session_id: str, stated: Iterable[tuple[str, Sequence[float] | None]]) -> None:
    """Raise InvalidContent for joint angles that are not as many as the joints of the robot, where there is one.

    `stated` are the angles by their field's name.
    """
    given = [(field, angles) for field, angles in stated if angles is not None]
    found = rows.first(_JOINTS, session_id=session_id) if given else None
    if found is None or not isinstance(found[0], list):
        return
    expected = len(found[0])
    wrong = [(field, len(angles)) for field, angles in given if len(angles) != expected]
    if wrong:
        raise InvalidContent(
            f"The session's robot has {expected} joints; {wrong[0][1]} joint angles are stated.",
            "Give the angles of all joints of the robot, first joint first, or PATCH the session's robot_id.",
            code="joint_angles_inconsistent",
            errors=[(field, f"must have {expected} numbers, as the robot has joints") for field, _ in wrong][
                :MAX_ERRORS
            ],
        )
