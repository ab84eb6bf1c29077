"""What an analysis is computed from: one session's finished measurements in a fixed order, and their hash.

The hash tells two sets of inputs apart and nothing else: it holds neither ids nor times, and no order in which things
arrived, so that the same images, tags and settings have the same hash in any session of any installation.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.jobs.row_queue import ALREADY_MEASURED
from app.records.tables import (
    MeasuredPose,
    Measurement,
    Pose,
    Result,
    Robot,
    Session,
    SessionTarget,
    Target,
    target_fields,
)
from app.services.lookup import find
from app.settings import program_version

NO_TARGET = -1
"""The place of the target of an image that shows none of the session's; it is never one with points."""
_FOREIGN = (
    "target_not_in_session",
    "It is of a target that the session does not look at; add it to the session's target_ids to have it count.",
)
ROBOT_ANALYSES = frozenset({"dh"})
"""Those that are computed from the robot's nominal joints, too."""
_OF_JOINT = ("a_mm", "alpha_deg", "d_mm", "theta_offset_deg")
"""What is computed from; names and limits are for other programs."""
_NUMBER = re.compile(r"(\d+)", re.ASCII)


@dataclass(frozen=True, slots=True)
class Image:
    """A finished measurement; `target` is its target's place in the session's list, or NO_TARGET.

    `point_bytes` is the size of its stored grid points, None where none were found, `marker_bytes` of its markers.
    `origin` is that of its grid points, None where there are none and where it was measured before that was kept.
    """

    measurement_id: str
    pose_id: str
    cycle: int | None
    sha256: str
    target: int
    focus_group: str
    joint_angles_deg: list[float] | None
    width_px: int
    height_px: int
    failure_code: str | None
    failure_detail: str | None
    point_bytes: int | None
    computed_by: str | None
    marker_bytes: int | None = None
    origin: str | None = None


@dataclass(frozen=True, slots=True)
class Commanded:
    """What the robot was told at a pose; everything may be unknown."""

    position_mm: list[float] | None
    roll_deg: float | None
    pitch_deg: float | None
    yaw_deg: float | None
    joint_angles_deg: list[float] | None
    approach: str | None


@dataclass(frozen=True, slots=True)
class Measured:
    """A reading of another instrument, by the hash of what was read."""

    measurement_id: str
    pose_id: str
    cycle: int | None
    content_sha256: str


@dataclass(frozen=True, slots=True)
class Reading:
    """What was read; `covariance` is of x, y, z (mm) and a small rotation (rad) from the left."""

    joint_angles_deg: list[float] | None
    position_mm: list[float]
    rotation: list[list[float]] | None
    covariance: list[list[float]] | None


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One session at one moment. `images` are in the order of pose (natural), cycle, hash and target; those without a
    cycle follow those with one. `pending` measurements are not finished, and not among them.

    Where an analysis is of another instrument's poses, `measured` are those in the same order, and there are no images.
    `robot` are the nominal parameters of the session's joints. `readings`, by their ids, are filled in where the
    analysis is computed (`read_readings`); the hash is without them. So are the `markers` of images, by measurement
    (`read_markers`), and by `naming` the measurements whose points others of their pose named, `parts_named`, and why
    others were not, `parts_refused`.
    """

    session_id: str
    target_ids: tuple[str, ...]
    targets: tuple[dict[str, Any], ...]
    lens: dict[str, float] | None
    intrinsics: dict[str, float] | None
    commanded: Mapping[str, Commanded]
    images: tuple[Image, ...]
    pending: int
    measured: tuple[Measured, ...] = ()
    robot: list[dict[str, float]] | None = None
    readings: Mapping[str, Reading] = field(default_factory=dict)
    markers: Mapping[str, bytes] = field(default_factory=dict)
    parts_named: frozenset[str] = frozenset()
    parts_refused: Mapping[str, str] = field(default_factory=dict)

    def inputs_sha256(self, analysis: str, settings: Mapping[str, Any]) -> str:
        """Return the hash of everything that `analysis` with `settings` is computed from, this program included."""
        inputs = {
            "analysis": analysis,
            "settings": dict(settings),
            "core_version": program_version(),
            "lens": self.lens,
            "intrinsics": self.intrinsics,
            "targets": self.targets,
            "poses": [
                [pose_id, asdict(self.commanded[pose_id])] for pose_id in sorted(self.commanded, key=natural)
            ],
            "images": [
                [
                    image.pose_id,
                    image.cycle,
                    image.sha256,
                    image.target,
                    image.focus_group,
                    image.joint_angles_deg,
                    image.failure_code,
                    image.point_bytes,
                    image.computed_by,
                    image.marker_bytes,
                    image.origin,
                ]
                for image in self.images
            ],
            "measured": [[m.pose_id, m.cycle, m.content_sha256] for m in self.measured],
            "robot": self.robot if analysis in ROBOT_ANALYSES else None,
        }
        text = json.dumps(inputs, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


def natural(text: str) -> tuple[tuple[tuple[int, int, str], ...], str]:
    """Return a key that sorts P2 before P10; texts that differ have keys that differ."""
    parts = tuple(
        (0, int(part), "") if part.isdecimal() else (1, 0, part) for part in _NUMBER.split(text) if part
    )
    return parts, text


def read_snapshot(records: orm.Session, session_id: str, source: str = "images") -> Snapshot:
    """Read a session without its arrays; of its images or, with source `measured_poses`, its measured poses."""
    session = find(records, Session, session_id)
    target_ids = tuple(target.target_id for target in session.targets)
    rows = {row.id: row for row in records.scalars(sa.select(Target).where(Target.id.in_(target_ids)))}
    images: tuple[Image, ...] = ()
    measured: tuple[Measured, ...] = ()
    if source == "measured_poses":
        measured = _read_measured(records, session_id)
    else:
        places = {target_id: place for place, target_id in enumerate(target_ids)}
        images = _read_images(records, session_id, places)
    named = {image.pose_id for image in images} | {reading.pose_id for reading in measured}
    robot = records.get(Robot, session.robot_id) if session.robot_id is not None else None
    return Snapshot(
        session_id=session_id,
        target_ids=target_ids,
        targets=tuple(target_fields(rows[i]) for i in target_ids),
        lens=session.lens,
        intrinsics=session.intrinsics,
        commanded={
            pose_id: commanded for pose_id, commanded in _read_poses(records, session_id) if pose_id in named
        },
        images=images,
        measured=measured,
        robot=[{name: joint[name] for name in _OF_JOINT} for joint in robot.joints]
        if robot is not None
        else None,
        pending=0
        if source == "measured_poses"
        else records.scalar(
            sa.select(sa.func.count()).where(
                Measurement.session_id == session_id, Measurement.status.in_(("queued", "running"))
            )
        )
        or 0,
    )


def read_points(records: orm.Session, session_id: str) -> dict[str, bytes]:
    """Return the stored grid points of every finished measurement of the session's targets that has any, by its id."""
    rows = records.connection().execute(
        sa.select(Result.measurement_id, Result.points)
        .join(Measurement, Measurement.id == Result.measurement_id)
        .join(
            SessionTarget,
            sa.and_(
                SessionTarget.session_id == Measurement.session_id,
                SessionTarget.target_id == Measurement.target_id,
            ),
        )
        .where(Measurement.session_id == session_id, Result.points.is_not(None))
    )
    return {measurement_id: points for measurement_id, points in rows if points is not None}


def read_markers(records: orm.Session, session_id: str) -> dict[str, bytes]:
    """Return the stored markers of every finished measurement of a target that has any, by its id."""
    rows = records.execute(
        sa.select(Result.measurement_id, Result.markers)
        .join(Measurement, Measurement.id == Result.measurement_id)
        .where(Measurement.session_id == session_id, Result.markers.is_not(None))
    )
    return {measurement_id: markers for measurement_id, markers in rows if markers is not None}


def read_readings(records: orm.Session, session_id: str) -> dict[str, Reading]:
    """Return what other instruments read, by the readings' ids."""
    rows = records.execute(
        sa.select(
            MeasuredPose.id,
            MeasuredPose.joint_angles_deg,
            MeasuredPose.position_mm,
            MeasuredPose.rotation,
            MeasuredPose.covariance,
        ).where(MeasuredPose.session_id == session_id)
    )
    return {row[0]: Reading(*row[1:]) for row in rows}


def _read_measured(records: orm.Session, session_id: str) -> tuple[Measured, ...]:
    rows = records.execute(
        sa.select(
            MeasuredPose.id, MeasuredPose.pose_id, MeasuredPose.cycle, MeasuredPose.content_sha256
        ).where(MeasuredPose.session_id == session_id)
    )
    measured = [Measured(*row) for row in rows]
    keys = {pose_id: natural(pose_id) for pose_id in {m.pose_id for m in measured}}
    return tuple(
        sorted(measured, key=lambda m: (keys[m.pose_id], m.cycle is None, m.cycle or 0, m.content_sha256))
    )


def _read_images(records: orm.Session, session_id: str, places: Mapping[str, int]) -> tuple[Image, ...]:
    rows = (
        records.connection()
        .execute(  # plain rows: no entity is loaded
            sa.select(  # in the order of Image's fields
                Measurement.id,
                Measurement.pose_id,
                Measurement.cycle,
                Measurement.sha256,
                Measurement.target_id,
                Measurement.focus_group,
                Measurement.joint_angles_deg,
                Measurement.image_width_px,
                Measurement.image_height_px,
                Measurement.failure_code,
                Measurement.failure_detail,
                sa.func.length(Result.points),
                Result.core_version,
                sa.func.length(Result.markers),
                Result.origin,
            )
            .outerjoin(Result, Result.measurement_id == Measurement.id)
            .where(
                Measurement.session_id == session_id,
                Measurement.status.in_(("succeeded", "failed")),
                # Such a row says nothing that the image's other rows do not, and whether there is one tells in which
                # order the uploads came.
                sa.func.coalesce(Measurement.failure_code, "") != ALREADY_MEASURED.code,
            )
        )
        .all()
    )
    fields: list[tuple[Any, ...]] = [
        (*row[:4], NO_TARGET if row[4] is None else places[row[4]], *row[5:])
        if row[4] is None or row[4] in places
        else (*row[:4], NO_TARGET, *row[5:9], *_FOREIGN, None, row[12])
        for row in rows
    ]
    images = [Image(*row) for row in fields]
    names = sorted({image.pose_id for image in images}, key=natural)
    rank = {pose_id: place for place, pose_id in enumerate(names)}
    return tuple(
        sorted(images, key=lambda i: (rank[i.pose_id], i.cycle is None, i.cycle or 0, i.sha256, i.target))
    )


def _read_poses(records: orm.Session, session_id: str) -> list[tuple[str, Commanded]]:
    rows = records.execute(
        sa.select(
            Pose.pose_id,
            Pose.position_mm,
            Pose.roll_deg,
            Pose.pitch_deg,
            Pose.yaw_deg,
            Pose.joint_angles_deg,
            Pose.approach,
        ).where(Pose.session_id == session_id)
    ).all()
    return [(row[0], Commanded(*row[1:])) for row in rows]
