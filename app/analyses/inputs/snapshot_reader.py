"""Reading a session's inputs from its rows, in a fixed order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.analyses.inputs.session_subject import session_subject
from app.analyses.inputs.snapshot import Snapshot, StoredImage, StoredPose
from app.analyses.inputs.stored_rows import IMAGE_ROWS, POSE_COLUMNS, readable_image, require_values
from app.errors import RowUnreadable
from app.jobs.queue import ALREADY_MEASURED, is_target
from app.records.tables import (
    MeasuredPose,
    Measurement,
    Pose,
    Result,
    Robot,
    Session,
    Target,
    measured_target_fields,
    target_fields,
)
from app.services.measured_poses import source_of
from app.services.qualifications import latest_qualification
from app.services.queries import get_or_raise, require_readable
from core import GridposeError
from core.session import NO_TARGET, CommandedPose, ImageObservation, natural
from core.targets import target_of

FOREIGN = "target_not_in_session"
_FOREIGN = (
    FOREIGN,
    "It is of a target that the session does not look at; add it to the session's target_ids to have it count.",
)
EXCLUDED = "excluded_by_user"
_OF_JOINT = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg")


def parameters_of(joint: Mapping[str, Any]) -> dict[str, float]:
    """Return what is computed from of a robot's joint; names and limits are for other programs.

    β is there where it is stated; without it, the hash is that of versions before it.
    """
    found = {name: joint[name] for name in _OF_JOINT}
    return found | {"beta_deg": joint["beta_deg"]} if joint.get("beta_deg") else found


def read_snapshot(records: orm.Session, session_id: str, source: str = "images") -> Snapshot:
    """Read a session without its arrays; of its images or, with source `measured_poses`, its measured poses.

    Raises NotFound, RowUnreadable; an image whose row cannot be read is a failed one.
    """
    session = get_or_raise(records, Session, session_id)
    require_readable(session)
    target_ids = tuple(target.target_id for target in session.targets)
    rows = {row.id: row for row in records.scalars(sa.select(Target).where(Target.id.in_(target_ids)))}
    for row in rows.values():
        require_readable(row)
        if not is_target(tuple(target_fields(row).items())):
            raise RowUnreadable(f"target ({row.id})", ["kind, columns, rows or lengths"])
        try:
            target_of(measured_target_fields(row, session.conditions))
        except GridposeError as error:
            raise RowUnreadable(f"target ({row.id})", ["certificate"]) from error
    images: tuple[StoredImage, ...] = ()
    measured: tuple[StoredPose, ...] = ()
    if source == "measured_poses":
        measured = _read_measured(records, session_id)
    else:
        places = {target_id: place for place, target_id in enumerate(target_ids)}
        images = _read_images(records, session_id, places)
    named = {image.observation.pose_id for image in images} | {reading.pose_id for reading in measured}
    robot = records.get(Robot, session.robot_id) if session.robot_id is not None else None
    if robot is not None:
        require_readable(robot)
        coupling = robot.joint_coupling
        if coupling is not None and {len(robot.joints)} != {len(coupling), *map(len, coupling)}:
            raise RowUnreadable(f"robot ({robot.id})", ["joint_coupling"])
    return Snapshot(
        session_id=session_id,
        target_ids=target_ids,
        targets=tuple(measured_target_fields(rows[i], session.conditions) for i in target_ids),
        lens=session.lens,
        intrinsics=session.intrinsics,
        commanded={
            pose_id: commanded for pose_id, commanded in _read_poses(records, session_id) if pose_id in named
        },
        images=images,
        measured=measured,
        measured_instead=source == "images" and not images and source_of(records, session_id) != source,
        subject=session_subject(
            session,
            robot,
            [rows[i] for i in target_ids],
            [image.captured_at for image in images],
            latest_qualification(records, session.robot_id, source),
        ),
        robot=None if robot is None else [parameters_of(joint) for joint in robot.joints],
        joint_coupling=robot.joint_coupling if robot is not None else None,
        camera_mount="fixed" if session.camera_mount == "fixed" else "robot",
        datasheet={
            # Earlier versions took zero, which no arm keeps: it is as good as not stated.
            "repeatability_mm": robot.datasheet_repeatability_mm or None,
            "accuracy_mm": robot.datasheet_accuracy_mm or None,
        }
        if robot is not None
        else {},
        pending=0
        if source == "measured_poses"
        else records.scalar(
            sa.select(sa.func.count()).where(
                Measurement.session_id == session_id, Measurement.status.in_(("queued", "running"))
            )
        )
        or 0,
    )


def _read_measured(records: orm.Session, session_id: str) -> tuple[StoredPose, ...]:
    rows = records.execute(
        sa.select(
            MeasuredPose.id, MeasuredPose.pose_id, MeasuredPose.cycle, MeasuredPose.content_sha256
        ).where(MeasuredPose.session_id == session_id)
    )
    measured = [StoredPose(*row) for row in rows]
    keys = {pose_id: natural(pose_id) for pose_id in {m.pose_id for m in measured}}
    return tuple(
        sorted(measured, key=lambda m: (keys[m.pose_id], m.cycle is None, m.cycle or 0, m.content_sha256))
    )


def _read_images(records: orm.Session, session_id: str, places: Mapping[str, int]) -> tuple[StoredImage, ...]:
    rows = (
        records.connection()
        .execute(  # plain rows: no entity is loaded
            IMAGE_ROWS.outerjoin(Result, Result.measurement_id == Measurement.id).where(
                Measurement.session_id == session_id,
                # One that is computed again has its earlier result until another one replaces it.
                sa.or_(Measurement.status.in_(("succeeded", "failed")), Result.measurement_id.is_not(None)),
                # Such a row repeats the image's other rows, and its existence depends on the order of the uploads.
                sa.func.coalesce(Measurement.failure_code, "") != ALREADY_MEASURED.code,
            )
        )
        .all()
    )
    images = [_stored_image(readable_image(row), places) for row in rows]
    names = sorted({image.observation.pose_id for image in images}, key=natural)
    rank = {pose_id: place for place, pose_id in enumerate(names)}

    def order(image: StoredImage) -> tuple[int, bool, int, str, int]:
        seen = image.observation
        return rank[seen.pose_id], seen.cycle is None, seen.cycle or 0, seen.image, seen.target

    return tuple(sorted(images, key=order))


def _stored_image(row: tuple[Any, ...], places: Mapping[str, int]) -> StoredImage:
    """Return the image of an `IMAGE_ROWS` row; one excluded, or of a target not the session's, is a failed one."""
    *fields, exclusion, filename, burst, captured_at, received_at, stated = row
    if fields[4] is not None and fields[4] not in places:
        fields = [*fields[:4], None, *fields[5:9], *_FOREIGN, None, fields[12], None, None]
    if exclusion is not None:
        fields = [*fields[:9], EXCLUDED, exclusion["reason"], None, fields[12], None, None]
    seen, (point_bytes, computed_by, content_sha256, labelling) = fields[:11], fields[11:]
    target = NO_TARGET if seen[4] is None else places[seen[4]]
    observation = ImageObservation(*[*seen[:4], target, *seen[5:], labelling or "absolute", filename, burst])
    return StoredImage(
        observation,
        point_bytes,
        computed_by,
        content_sha256,
        labelling,
        captured_at,
        received_at,
        stated_target_id=stated if target != NO_TARGET and stated != seen[4] else None,
    )


def _read_poses(records: orm.Session, session_id: str) -> list[tuple[str, CommandedPose]]:
    rows = records.execute(sa.select(*POSE_COLUMNS).where(Pose.session_id == session_id)).all()
    poses = [(row[0], CommandedPose(*row[1:])) for row in rows]
    for pose_id, commanded in poses:
        require_values("pose", pose_id, Pose, commanded)
    return poses
