"""Poses: what the robot was told, under the user's own tags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import InvalidContent, NotFound
from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import Pose, Session
from app.services.lookup import find


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
    records: orm.Session, session_id: str, pose_id: str, commanded: CommandedPose
) -> tuple[Pose, bool]:
    """Store a pose and tell whether it is new; an existing one is replaced whole."""
    find(records, Session, session_id, lock=True)
    pose = _find_pose(records, session_id, pose_id)
    if pose is not None:
        _assign(pose, commanded)
        return pose, False
    pose = _new_pose(session_id, pose_id, commanded)
    records.add(pose)
    return pose, True


def put_poses(records: orm.Session, session_id: str, items: Sequence[tuple[str, CommandedPose]]) -> None:
    """Store many poses, new or replaced, in the order given; all of them or none."""
    find(records, Session, session_id, lock=True)
    seen: set[str] = set()
    repeated = []
    for position, (pose_id, _) in enumerate(items):
        if pose_id in seen:
            repeated.append((f"{position}.pose_id", "stands in the list more than once"))
        seen.add(pose_id)
    if repeated:
        raise InvalidContent(
            "A pose stands in the list more than once.",
            "Send every pose once; nothing of this list was stored.",
            code="duplicate_pose",
            errors=repeated[:100],
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
    find(records, Session, session_id)
    pose = _find_pose(records, session_id, pose_id)
    if pose is None:
        raise NotFound.of("pose")
    return pose


def list_poses(
    records: orm.Session, session_id: str, *, limit: int, cursor: str | None
) -> tuple[Sequence[Pose], str | None]:
    """Return one page of a session's poses."""
    find(records, Session, session_id)
    return page(
        records, sa.select(Pose).where(Pose.session_id == session_id), Pose.id, limit=limit, cursor=cursor
    )


def ensure_pose(records: orm.Session, session_id: str, pose_id: str) -> None:
    """Make a pose that an image names for the first time, with everything about it unknown."""
    if _find_pose(records, session_id, pose_id) is None:
        records.add(_new_pose(session_id, pose_id, CommandedPose()))
        records.flush()


def _find_pose(records: orm.Session, session_id: str, pose_id: str) -> Pose | None:
    return records.scalar(sa.select(Pose).where(Pose.session_id == session_id, Pose.pose_id == pose_id))


def _new_pose(session_id: str, pose_id: str, commanded: CommandedPose) -> Pose:
    return Pose(id=new_id("pos"), session_id=session_id, pose_id=pose_id, **asdict(commanded))


def _assign(pose: Pose, commanded: CommandedPose) -> None:
    for field, value in asdict(commanded).items():
        setattr(pose, field, value)
