"""Poses that another instrument measured: checked whole, stored once however often they are sent."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import sqlalchemy as sa
from sqlalchemy import orm

from app.errors import Conflict, InvalidContent
from app.records.activity import note_objects
from app.records.ids import new_id
from app.records.pagination import page
from app.records.tables import MeasuredPose, Measurement, Pose, Robot, Session
from app.services import plausibility
from app.services.queries import get_or_raise, require_readable

ORTHONORMAL = 1e-5
"""A rotation written with six decimals passes, a scaled, mirrored or transcribed one does not."""
SEMIDEFINITE = 1e-4
"""Relative, of correlations: a covariance written with four digits passes."""
MAX_ERRORS = 100
MAX_IN_SESSION = 20_000
"""More than any standard's test has by two orders; analyses of so many keep within their time and memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What an instrument read at a pose; `app.api.schemas.measured_poses` says in which units and frames."""

    pose_id: str
    cycle: int | None
    joint_angles_deg: list[float] | None
    position_mm: list[float]
    rotation: list[list[float]] | None
    covariance: list[list[float]] | None

    def content_sha256(self) -> str:
        """Return the hash of the reading but for the session it is in."""
        text = json.dumps(asdict(self), sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.replace("-0.0,", "0.0,").replace("-0.0]", "0.0]").encode()).hexdigest()


def check_readings(readings: Sequence[Reading]) -> None:
    """Raise InvalidContent, naming each reading by its place, where the list cannot be stored by any session."""
    _refuse_invalid(readings)
    _refuse_repeated(readings)
    numbers = {len(r.joint_angles_deg) for r in readings if r.joint_angles_deg is not None}
    if len(numbers) > 1:
        found = ", ".join(str(number) for number in sorted(numbers))
        raise InvalidContent(
            f"The readings carry different numbers of joint angles: {found}.",
            "Give every reading the angles of all joints, or none.",
            code="joint_angles_inconsistent",
            errors=_wrong_joints(readings, max(numbers)),
        )


def put_measured_poses(
    records: orm.Session, session_id: str, readings: Sequence[Reading], *, accept_implausible: bool = False
) -> list[str]:
    """Store checked readings and return their ids in the order given; those stored already keep theirs.

    Raises InvalidContent where the number of joints is not the robot's, or new readings look like another unit, unless
    that is accepted (`check_readings` of `.plausibility`); Conflict where a cycle of a pose is stored
    with another content, or where the session would hold more than MAX_IN_SESSION.
    """
    session = get_or_raise(records, Session, session_id, lock=True)
    _require_joints(records, session, readings)
    stored = records.execute(
        sa.select(
            MeasuredPose.pose_id, MeasuredPose.cycle, MeasuredPose.content_sha256, MeasuredPose.id
        ).where(MeasuredPose.session_id == session_id)
    ).all()
    by_content = {(row.pose_id, row.content_sha256): row.id for row in stored}
    cycles = {(row.pose_id, row.cycle) for row in stored if row.cycle is not None}
    ids: list[str] = []
    new: list[dict[str, Any]] = []
    differing: list[tuple[str, str]] = []
    for place, reading in enumerate(readings):
        sha256 = reading.content_sha256()
        row_id = by_content.get((reading.pose_id, sha256))
        if row_id is None:
            if (reading.pose_id, reading.cycle) in cycles:
                differing.append((f"{place}.cycle", "is stored with another content"))
            row_id = new_id("mpo")
            new.append({"id": row_id, "session_id": session_id, "content_sha256": sha256, **asdict(reading)})
        ids.append(row_id)
    if differing:
        raise Conflict(
            f"{len(differing)} readings differ from what is stored for the same cycle of the same pose.",
            "Nothing of this list was stored: give another visit another cycle; to correct a reading, delete the "
            "stored one (DELETE .../measured-poses?pose_id=&cycle=, `gridpose measured-poses delete`) and send this "
            "again.",
            code="measured_pose_conflict",
            errors=differing[:MAX_ERRORS],
        )
    if new and len(stored) + len(new) > MAX_IN_SESSION:
        raise Conflict(
            f"The session holds {len(stored)} measured poses; with {len(new)} more it would exceed the "
            f"{MAX_IN_SESSION} that one session may hold.",
            "Nothing of this list was stored: put these readings into another session, or delete some that are stored "
            "(DELETE .../measured-poses).",
            code="too_many_measured_poses",
        )
    if new and not accept_implausible:
        _require_unit(records, session_id, readings)
    _ensure_poses(records, session_id, {row["pose_id"] for row in new})
    if new:
        records.execute(sa.insert(MeasuredPose), new)
    return ids


def source_of(records: orm.Session, session_id: str) -> str:
    """Return where a session's poses are from by itself: `measured_poses` only where there are no images at all."""
    for table, source in ((Measurement, "images"), (MeasuredPose, "measured_poses")):
        columns = table.__table__.c
        if records.scalar(sa.select(columns.id).where(columns.session_id == session_id).limit(1)):
            return source
    return "images"


def list_measured_poses(
    records: orm.Session, session_id: str, *, pose_id: str | None, limit: int, cursor: str | None
) -> tuple[Sequence[MeasuredPose], str | None]:
    """Return one page of a session's readings."""
    get_or_raise(records, Session, session_id)
    statement = sa.select(MeasuredPose).where(MeasuredPose.session_id == session_id)
    if pose_id is not None:
        statement = statement.where(MeasuredPose.pose_id == pose_id)
    return page(records, statement, MeasuredPose.id, limit=limit, cursor=cursor)


def delete_measured_poses(
    records: orm.Session, session_id: str, *, pose_id: str | None, cycle: int | None
) -> int:
    """Delete a session's readings, all or those of a pose, of a cycle or of both; return how many there were."""
    get_or_raise(records, Session, session_id, lock=True)
    statement = sa.delete(MeasuredPose).where(MeasuredPose.session_id == session_id)
    if pose_id is not None:
        statement = statement.where(MeasuredPose.pose_id == pose_id)
        note_objects([pose_id])
    if cycle is not None:
        statement = statement.where(MeasuredPose.cycle == cycle)
    deleted = records.scalars(
        statement.returning(MeasuredPose.id), execution_options={"synchronize_session": False}
    )
    return len(deleted.all())


def _refuse_invalid(readings: Sequence[Reading]) -> None:
    turned = [place for place, reading in enumerate(readings) if reading.rotation is not None]
    known = [place for place, reading in enumerate(readings) if reading.covariance is not None]
    errors = [
        (f"{place}.rotation", message)
        for place, message in _no_rotations(turned, [readings[place].rotation for place in turned])
    ]
    errors += [
        (f"{place}.covariance", message)
        for place, message in _no_covariances(known, [readings[place].covariance for place in known])
    ]
    if errors:
        raise InvalidContent(
            f"{len(errors)} matrices are not what they should be; the first: {errors[0][0]} {errors[0][1]}.",
            "Write matrices row by row, rotations with six decimals or more; `gridpose measured-poses import` makes "
            "them from Euler angles and quaternions.",
            code="invalid_matrix",
            errors=errors[:MAX_ERRORS],
        )


def _no_rotations(places: list[int], matrices: list[Any]) -> list[tuple[int, str]]:
    if not places:
        return []
    rotations = np.array(matrices, dtype=np.float64)
    off = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    mirrored = np.linalg.det(rotations) < 0.0
    return [
        (
            place,
            "is a reflection: its determinant is negative"
            if o <= ORTHONORMAL
            else f"is no rotation: R Rᵀ differs from the unit matrix by {o:.1e}, more than {ORTHONORMAL:g}",
        )
        for place, o, m in zip(places, off.tolist(), mirrored.tolist(), strict=True)
        if m or o > ORTHONORMAL
    ]


def _no_covariances(places: list[int], matrices: list[Any]) -> list[tuple[int, str]]:
    if not places:
        return []
    covariances = np.array(matrices, dtype=np.float64)
    variance = np.diagonal(covariances, axis1=1, axis2=2)
    # mm² and rad² differ by orders of magnitude, so that correlations are looked at.
    scale = np.sqrt(np.where(variance > 0.0, variance, 1.0))
    correlation = covariances / scale[:, :, None] / scale[:, None, :]
    uneven = np.abs(correlation - correlation.transpose(0, 2, 1)).max(axis=(1, 2)) > SEMIDEFINITE
    negative = np.asarray((variance < 0.0).any(axis=1))
    bounded = np.clip((correlation + correlation.transpose(0, 2, 1)) / 2.0, -1e6, 1e6)
    smallest = np.linalg.eigvalsh(bounded)[:, 0]
    found = []
    for place, u, n, s in zip(places, uneven.tolist(), negative.tolist(), smallest.tolist(), strict=True):
        if n:
            found.append((place, "has a negative variance"))
        elif u:
            found.append((place, "is not symmetric"))
        elif s < -SEMIDEFINITE:
            found.append(
                (place, f"is not positive semidefinite: of its correlations, one eigenvalue is {s:.1e}")
            )
    return found


def _refuse_repeated(readings: Sequence[Reading]) -> None:
    seen: set[tuple[str, int | None, str]] = set()
    repeated = []
    for place, reading in enumerate(readings):
        # Readings without a cycle are different readings, unless their content is identical.
        content = reading.content_sha256() if reading.cycle is None else ""
        key = (reading.pose_id, reading.cycle, content)
        if key in seen:
            repeated.append((f"{place}.pose_id", "occurs in the list more than once with this cycle"))
        seen.add(key)
    if repeated:
        raise InvalidContent(
            "A measured pose occurs in the list more than once.",
            "Send every cycle of a pose once; nothing of this list was stored.",
            code="duplicate_measured_pose",
            errors=repeated[:MAX_ERRORS],
        )


def _require_joints(records: orm.Session, session: Session, readings: Sequence[Reading]) -> None:
    given = next((len(r.joint_angles_deg) for r in readings if r.joint_angles_deg is not None), None)
    if given is None:
        return
    whose = "The session's robot has"
    robot = records.get(Robot, session.robot_id) if session.robot_id is not None else None
    if robot is not None:
        require_readable(robot)
        expected = len(robot.joints)
    else:
        whose = "The readings stored in this session have"
        stored = records.scalar(
            sa.select(MeasuredPose.joint_angles_deg)
            .where(MeasuredPose.session_id == session.id, MeasuredPose.joint_angles_deg.is_not(None))
            .limit(1)
        )
        expected = len(stored) if isinstance(stored, list) else given
    if expected != given:
        raise InvalidContent(
            f"{whose} {expected} joints, the readings carry {given} joint angles.",
            "Give the angles of all joints of the robot, first joint first, or PATCH the session's robot_id.",
            code="joint_angles_inconsistent",
            errors=_wrong_joints(readings, expected),
        )


def _require_unit(records: orm.Session, session_id: str, readings: Sequence[Reading]) -> None:
    stated = records.execute(
        sa.select(Pose.pose_id, Pose.position_mm).where(
            Pose.session_id == session_id, Pose.position_mm.is_not(None)
        )
    ).all()
    commanded = {row.pose_id: row.position_mm for row in stated if isinstance(row.position_mm, list)}
    plausibility.check_readings([(one.pose_id, one.position_mm) for one in readings], commanded)


def _wrong_joints(readings: Sequence[Reading], expected: int) -> list[tuple[str, str]]:
    return [
        (f"{place}.joint_angles_deg", f"must have {expected} numbers, as the others have")
        for place, reading in enumerate(readings)
        if reading.joint_angles_deg is not None and len(reading.joint_angles_deg) != expected
    ][:MAX_ERRORS]


def _ensure_poses(records: orm.Session, session_id: str, pose_ids: set[str]) -> None:
    """Make the poses that readings name for the first time, with everything about them unknown."""
    known = set(records.scalars(sa.select(Pose.pose_id).where(Pose.session_id == session_id)))
    new = [
        {"id": new_id("pos"), "session_id": session_id, "pose_id": pose_id}
        for pose_id in sorted(pose_ids - known)
    ]
    if new:
        records.execute(sa.insert(Pose), new)
