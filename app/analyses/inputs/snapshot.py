"""Inputs of an analysis: one session's measurements and their results in a fixed order, and the hash of all of them.

The hash identifies a set of inputs. It holds neither ids, nor times, nor the order of arrival, so that the same images,
tags and settings have the same hash in any session of any installation.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.analyses.inputs.session_subject import session_subject
from app.analyses.inputs.stored_rows import IMAGE_ROWS, POSE_COLUMNS, readable_image, require_values
from app.build import core_version
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
from core.session import NO_TARGET, CameraMount, CommandedPose, ImageObservation, natural
from core.targets import target_of

FOREIGN = "target_not_in_session"
_FOREIGN = (
    FOREIGN,
    "It is of a target that the session does not look at; add it to the session's target_ids to have it count.",
)
EXCLUDED = "excluded_by_user"
ROBOT_ANALYSES = frozenset(
    {
        *("dh", "hand_eye", "compensation", "joint_noise", "kinematic_error"),
        *("joint_noise_map", "joint_curves_plot", "error_map", "identifiability_plot"),
    }
)
"""Those that are computed from the robot's nominal joints, too."""
_OF_JOINT = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg")


@dataclass(frozen=True, slots=True)
class StoredImage:
    """What came of a measurement, as it is stored.

    `content_sha256` covers its grid points and markers; it is None if nothing was computed. `labelling` is that of its
    grid points; it is None without grid points and for results older than the column.
    """

    observation: ImageObservation
    point_bytes: int | None
    computed_by: str | None
    content_sha256: str | None = None
    labelling: str | None = None
    captured_at: datetime | None = None
    received_at: datetime | None = None


@dataclass(frozen=True, slots=True)
class StoredPose:
    """A pose that another instrument measured, by the hash of what it read."""

    measurement_id: str
    pose_id: str
    cycle: int | None
    content_sha256: str


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One session at one moment, without its arrays. `images` are in the order of pose (natural), cycle, hash and
    target; those without a cycle follow those with one. `pending` measurements are not finished: they are not among
    them, but for those that are computed again, whose earlier results stand.

    Where an analysis is of another instrument's poses, `measured` are those in the same order, and there are no images.
    `measured_instead` says that an analysis of images finds none, while there are such poses.
    `robot` are the nominal parameters of the session's joints, `joint_coupling` how these are coupled, `datasheet` what
    its maker states, `camera_mount` what the camera is on. `subject` is what answers say they are about.
    """

    session_id: str
    target_ids: tuple[str, ...]
    targets: tuple[dict[str, Any], ...]
    lens: dict[str, float] | None
    intrinsics: dict[str, float] | None
    commanded: Mapping[str, CommandedPose]
    images: tuple[StoredImage, ...]
    pending: int
    measured: tuple[StoredPose, ...] = ()
    robot: list[dict[str, float]] | None = None
    joint_coupling: list[list[float]] | None = None
    datasheet: Mapping[str, float | None] = field(default_factory=dict)
    subject: Mapping[str, Any] = field(default_factory=dict)
    camera_mount: CameraMount = "robot"
    measured_instead: bool = False

    def answer_sha256(self, analysis: str, settings: Mapping[str, Any]) -> str:
        """Return the hash of all that an answer is made of: its inputs, and ids, names and times."""
        parts = [
            self.inputs_sha256(analysis, settings),
            self.pending,
            self.subject,
            [
                [
                    *(image.observation.measurement_id, image.observation.filename),
                    *(str(image.captured_at), str(image.received_at)),
                ]
                for image in self.images
            ],
            [pose.measurement_id for pose in self.measured],
        ]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    def inputs_sha256(self, analysis: str, settings: Mapping[str, Any]) -> str:
        """Return the hash of everything that `analysis` with `settings` is computed from, this program included."""
        inputs = {
            "analysis": analysis,
            "settings": dict(settings),
            "core_version": core_version(),
            "lens": self.lens,
            "intrinsics": self.intrinsics,
            "targets": self.targets,
            "poses": [
                [pose_id, asdict(self.commanded[pose_id])] for pose_id in sorted(self.commanded, key=natural)
            ],
            "images": [
                [
                    image.observation.pose_id,
                    image.observation.cycle,
                    image.observation.image,
                    image.observation.target,
                    image.observation.focus_group,
                    image.observation.joint_angles_deg,
                    image.observation.failure_code,
                    self._without_ids(image.observation.failure_detail),
                    image.computed_by,
                    image.content_sha256,
                    image.labelling,
                    # Without one, the hash is that of versions before it.
                    *([["burst", image.observation.burst]] if image.observation.burst is not None else []),
                ]
                for image in self.images
            ],
            "measured": [[m.pose_id, m.cycle, m.content_sha256] for m in self.measured],
            "robot": self.robot if analysis in ROBOT_ANALYSES else None,
            "joint_coupling": self.joint_coupling if analysis in ROBOT_ANALYSES else None,
            "datasheet": dict(self.datasheet) if analysis == "repeatability" else None,
            # With the camera on the robot, the hash is that of versions before it; other instruments have no mount.
            **({"camera_mount": "fixed"} if self.camera_mount == "fixed" and not self.measured else {}),
            **({"measured_instead": True} if self.measured_instead else {}),
        }
        text = json.dumps(inputs, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def _without_ids(self, text: str | None) -> str | None:
        """Return a refusal's text, which analyses show, with the session's targets named by their places."""
        if text is not None and "_" in text:
            for place, target_id in enumerate(self.target_ids):
                text = text.replace(target_id, f"<{place}>")
        return text


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
            "repeatability_mm": robot.datasheet_repeatability_mm,
            "accuracy_mm": robot.datasheet_accuracy_mm,
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
    *fields, exclusion, filename, burst, captured_at, received_at = row
    if fields[4] is not None and fields[4] not in places:
        fields = [*fields[:4], None, *fields[5:9], *_FOREIGN, None, fields[12], None, None]
    if exclusion is not None:
        fields = [*fields[:9], EXCLUDED, exclusion["reason"], None, fields[12], None, None]
    seen, (point_bytes, computed_by, content_sha256, labelling) = fields[:11], fields[11:]
    target = NO_TARGET if seen[4] is None else places[seen[4]]
    observation = ImageObservation(*[*seen[:4], target, *seen[5:], labelling or "absolute", filename, burst])
    return StoredImage(
        observation, point_bytes, computed_by, content_sha256, labelling, captured_at, received_at
    )


def _read_poses(records: orm.Session, session_id: str) -> list[tuple[str, CommandedPose]]:
    rows = records.execute(sa.select(*POSE_COLUMNS).where(Pose.session_id == session_id)).all()
    poses = [(row[0], CommandedPose(*row[1:])) for row in rows]
    for pose_id, commanded in poses:
        require_values("pose", pose_id, Pose, commanded)
    return poses
