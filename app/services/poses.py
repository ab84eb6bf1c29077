"""Commanded poses, under the user's own tags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict, InvalidContent, NotFound
from app.records.ids import new_id
from app.records.pagination import page
from app.records.statements import Rows, Statement, rows_of
from app.records.tables import Pose, Session
from app.services.plausibility import require_joints
from app.services.queries import get_or_raise

_COLUMNS = tuple(Pose.__table__.c.keys())
_FIND = Statement(
    sa.select(Pose.id).where(
        Pose.session_id == sa.bindparam("session_id"), Pose.pose_id == sa.bindparam("pose_id")
    )
)
_ADD = Statement(sa.insert(Pose), _COLUMNS)


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandedPose:
    """What a client says about a pose; every field of it may be unknown."""

    position_mm: list[float] | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    joint_angles_deg: list[float] | None = None
    approach: str | None = None


def put_pose(
    records: orm.Session, session_id: str, pose_id: str, commanded: CommandedPose, *, overwrite: bool = True
) -> tuple[Pose, bool]:
    """Store a pose and return it and whether it is new; an existing one is replaced whole.

    Without `overwrite`, Conflict is raised where a stored value would become another one or null. Raises InvalidContent
    for joint angles that are not as many as the robot's joints.
    """
    get_or_raise(records, Session, session_id, lock=True)
    require_joints(rows_of(records), session_id, [("joint_angles_deg", commanded.joint_angles_deg)])
    pose = _find_pose(records, session_id, pose_id)
    if pose is not None:
        if not overwrite:
            _refuse_changes([(pose, commanded, "")])
        _assign(pose, commanded)
        return pose, False
    pose = _new_pose(session_id, pose_id, commanded)
    records.add(pose)
    return pose, True


def put_poses(
    records: orm.Session,
    session_id: str,
    items: Sequence[tuple[str, CommandedPose]],
    *,
    overwrite: bool = True,
) -> None:
    """Store many poses, new or replaced, in the order given; all of them or none. `overwrite` as in `put_pose`."""
    get_or_raise(records, Session, session_id, lock=True)
    seen: set[str] = set()
    repeated = []
    for position, (pose_id, _) in enumerate(items):
        if pose_id in seen:
            repeated.append((f"{position}.pose_id", "occurs in the list more than once"))
        seen.add(pose_id)
    if repeated:
        raise InvalidContent(
            "A pose occurs in the list more than once.",
            "Send every pose once; nothing of this list was stored.",
            code="duplicate_pose",
            errors=repeated[:100],
        )
    angles = [(f"{place}.joint_angles_deg", one.joint_angles_deg) for place, (_, one) in enumerate(items)]
    require_joints(rows_of(records), session_id, angles)
    if not overwrite:
        stored = {
            pose.pose_id: pose
            for pose in records.scalars(sa.select(Pose).where(Pose.session_id == session_id))
        }
        _refuse_changes(
            [
                (stored[pose_id], commanded, f"{position}.")
                for position, (pose_id, commanded) in enumerate(items)
                if pose_id in stored
            ]
        )
    known = records.execute(sa.select(Pose.pose_id, Pose.id).where(Pose.session_id == session_id))
    row_ids = {row.pose_id: row.id for row in known}
    replaced: list[dict[str, Any]] = []
    new: list[dict[str, Any]] = []
    for pose_id, commanded in items:
        if pose_id in row_ids:
            replaced.append({"id": row_ids[pose_id], **asdict(commanded)})
        else:
            new.append(
                {"id": new_id("pos"), "session_id": session_id, "pose_id": pose_id, **asdict(commanded)}
            )
    # In bulk, since the write lock is held meanwhile: row by row, a hundred thousand poses keep uploads waiting.
    if replaced:
        records.execute(sa.update(Pose), replaced)
    if new:
        records.execute(sa.insert(Pose), new)


def get_pose(records: orm.Session, session_id: str, pose_id: str) -> Pose:
    """Return one pose."""
    get_or_raise(records, Session, session_id)
    pose = _find_pose(records, session_id, pose_id)
    if pose is None:
        raise NotFound.of("pose")
    return pose


def list_poses(
    records: orm.Session, session_id: str, *, limit: int, cursor: str | None
) -> tuple[Sequence[Pose], str | None]:
    """Return one page of a session's poses."""
    get_or_raise(records, Session, session_id)
    return page(
        records, sa.select(Pose).where(Pose.session_id == session_id), Pose.id, limit=limit, cursor=cursor
    )


def get_or_create_pose(records: orm.Session, session_id: str, pose_id: str) -> None:
    """Make a pose that an image names for the first time, with everything about it unknown."""
    ensure_pose(rows_of(records), session_id, pose_id)


def ensure_pose(rows: Rows, session_id: str, pose_id: str) -> None:
    """The same below the ORM."""
    if rows.first(_FIND, session_id=session_id, pose_id=pose_id) is None:
        unknown = dict.fromkeys(_COLUMNS)
        rows.all(_ADD, **{**unknown, "id": new_id("pos"), "session_id": session_id, "pose_id": pose_id})


def _find_pose(records: orm.Session, session_id: str, pose_id: str) -> Pose | None:
    return records.scalar(sa.select(Pose).where(Pose.session_id == session_id, Pose.pose_id == pose_id))


def _new_pose(session_id: str, pose_id: str, commanded: CommandedPose) -> Pose:
    return Pose(id=new_id("pos"), session_id=session_id, pose_id=pose_id, **asdict(commanded))


def _assign(pose: Pose, commanded: CommandedPose) -> None:
    for field, value in asdict(commanded).items():
        setattr(pose, field, value)


def _refuse_changes(pairs: Sequence[tuple[Pose, CommandedPose, str]]) -> None:
    """Raise Conflict where a commanded pose differs from a value that is stored; the text begins a field's place."""
    differing = [
        (f"{place}{field}", "is stored with another value")
        for pose, commanded, place in pairs
        for field, value in asdict(commanded).items()
        if getattr(pose, field) is not None and getattr(pose, field) != value
    ]
    if differing:
        raise Conflict(
            "A commanded pose is stored with other values, which a key of scope ingest may not change.",
            "Send the values as they are stored, or use a key of scope upload to correct them.",
            code="commanded_pose_conflict",
            errors=differing[:100],
        )
