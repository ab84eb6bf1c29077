"""The session's values from its rows: the only place where grid points and measured poses are decoded."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import sqlalchemy as sa
from jaxtyping import Float
from sqlalchemy import orm

from app.analyses.inputs.snapshot import Snapshot, StoredImage, StoredPose
from app.analyses.inputs.stored_rows import require_values
from app.records import tables
from app.records.codec import are_markers, are_points, decode_markers, decode_stack
from app.records.tables import Measurement, Result
from core import Camera, Lens, TargetSpec
from core.calibration import quarter_turns
from core.geometry import nearest_rotation
from core.kinematics import Chain, JointParameters
from core.session import (
    CameraViews,
    Datasheet,
    ImageObservation,
    MeasuredPose,
    SessionData,
    semidefinite,
)
from core.targets import target_of

Markers = Mapping[str, Mapping[int, Float[np.ndarray, "4 2"]]]
"""Corners (px) of the markers seen, by their ids, by measurement."""
PARTIAL = "partial"
"""Stored by earlier versions with the points of partial views without labels, which no analysis uses."""


def load_session(records: orm.Session, snapshot: Snapshot, source: str = "images") -> SessionData:
    """Read what the session's figures are computed from; grid points are decoded here and nowhere else.

    Raises RowUnreadable.
    """
    targets = tuple(target_of(fields) for fields in snapshot.targets)
    images = tuple(_observation(image, targets) for image in snapshot.images)
    measured: tuple[MeasuredPose, ...] = ()
    views: tuple[CameraViews, ...] = ()
    if source == "measured_poses":
        measured = _read_readings(records, snapshot)
    else:
        points = _read_points(records, snapshot)
        for image in snapshot.images:
            if image.labelling == "partial":  # a part of a board, whose points have no labels
                points.pop(image.observation.measurement_id, None)
        views = _views(images, points, targets)
    taken_h, time_source = _times(snapshot.images)
    return SessionData(
        targets=targets,
        target_ids=snapshot.target_ids,
        images=images,
        views=views,
        commanded=snapshot.commanded,
        measured=measured,
        lens=Lens(**snapshot.lens) if snapshot.lens is not None else None,
        intrinsics=Camera(**snapshot.intrinsics) if snapshot.intrinsics is not None else None,
        nominal=nominal_chain(snapshot.robot),
        joint_coupling=None if snapshot.joint_coupling is None else np.array(snapshot.joint_coupling),
        datasheet=Datasheet(**snapshot.datasheet),
        pending=snapshot.pending,
        taken_h=taken_h,
        time_source=time_source,
        camera_mount=snapshot.camera_mount,
        measured_instead=snapshot.measured_instead,
    )


def _times(images: Sequence[StoredImage]) -> tuple[dict[str, float], str | None]:
    """Return when images were taken, h after the first one: as stated where all say so, else when they came."""
    for source in ("captured_at", "received_at"):
        times = {one.observation.measurement_id: getattr(one, source) for one in images}
        if times and None not in times.values():
            first = min(times.values())
            return {name: (time - first).total_seconds() / 3600.0 for name, time in times.items()}, source
    return {}, None


def nominal_chain(robot: Sequence[Mapping[str, float]] | None) -> Chain | None:
    """Return the robot as it was described to the service."""
    if robot is None:
        return None
    return Chain(
        tuple(
            JointParameters(
                joint["a_mm"],
                math.radians(joint["alpha_deg"]),
                joint["d_mm"],
                math.radians(joint["theta_offset_deg"]),
                math.radians(joint.get("beta_deg") or 0.0),
            )
            for joint in robot
        )
    )


def _observation(image: StoredImage, targets: Sequence[TargetSpec]) -> ImageObservation:
    """Return the observation; of one from before the origin was kept, with the origin that the target's kind gives."""
    seen = image.observation
    if image.labelling is None and image.point_bytes and len(quarter_turns(targets[seen.target])) > 1:
        return replace(seen, labelling="up_to_symmetry")
    return seen


def _views(
    images: Sequence[ImageObservation], points: Mapping[str, bytes], targets: Sequence[TargetSpec]
) -> tuple[CameraViews, ...]:
    """Decode the grid points of images, camera setting by camera setting."""
    settings: dict[tuple[str, int, int], list[int]] = {}
    for i, image in enumerate(images):
        if image.measurement_id in points:
            settings.setdefault((image.focus_group, image.width_px, image.height_px), []).append(i)
    return tuple(
        CameraViews(
            name,
            np.array(members),
            decode_stack(
                [points[images[i].measurement_id] for i in members],
                targets,
                [images[i].target for i in members],
                width_px,
                height_px,
            ),
        )
        for (name, width_px, height_px), members in settings.items()
    )


def _read_points(records: orm.Session, snapshot: Snapshot) -> dict[str, bytes]:
    """Return the stored grid points of every image of the snapshot that has any there, by its measurement.

    Those of a target that is not the session's, and those that a user excluded, have none there.
    """
    counted = {image.observation.measurement_id for image in snapshot.images if image.point_bytes}
    asked = (
        sa.select(Result.measurement_id, Result.points)
        .join(Measurement, Measurement.id == Result.measurement_id)
        .where(
            Measurement.session_id == snapshot.session_id,
            Result.points.is_not(None),
            sa.func.coalesce(Result.labelling, "") != PARTIAL,
        )
    )
    rows = records.connection().execute(asked).all()  # at once, not one call a row
    return {name: points for name, points in rows if name in counted and are_points(points)}


def read_markers(records: orm.Session, session_id: str) -> Markers:
    """Return the markers of every finished measurement of a target that has any."""
    rows = records.execute(
        sa.select(Result.measurement_id, Result.markers)
        .join(Measurement, Measurement.id == Result.measurement_id)
        .where(
            Measurement.session_id == session_id,
            Measurement.excluded.is_(None),
            Result.markers.is_not(None),
        )
    )
    return {one: decode_markers(stored) for one, stored in rows if are_markers(stored)}


def _read_readings(records: orm.Session, snapshot: Snapshot) -> tuple[MeasuredPose, ...]:
    rows = records.execute(
        sa.select(
            tables.MeasuredPose.id,
            tables.MeasuredPose.joint_angles_deg,
            tables.MeasuredPose.position_mm,
            tables.MeasuredPose.rotation,
            tables.MeasuredPose.covariance,
        ).where(tables.MeasuredPose.session_id == snapshot.session_id)
    )
    readings = {row[0]: _Reading(*row[1:]) for row in rows}
    for measurement_id, reading in readings.items():
        require_values("measured pose", measurement_id, tables.MeasuredPose, reading)
    return tuple(_measured_pose(stored, readings[stored.measurement_id]) for stored in snapshot.measured)


@dataclass(frozen=True, slots=True)
class _Reading:
    """The columns of a measured pose."""

    joint_angles_deg: list[float] | None
    position_mm: list[float]
    rotation: list[list[float]] | None
    covariance: list[list[float]] | None


def _measured_pose(stored: StoredPose, reading: _Reading) -> MeasuredPose:
    rotation = covariance = None
    if reading.rotation is not None:
        rotation = nearest_rotation(np.array(reading.rotation, dtype=np.float64))
    if reading.covariance is not None:
        covariance = semidefinite(np.array(reading.covariance, dtype=np.float64))
    return MeasuredPose(
        stored.measurement_id,
        stored.pose_id,
        stored.cycle,
        reading.joint_angles_deg,
        np.array(reading.position_mm, dtype=np.float64),
        rotation,
        covariance,
        covariance,
    )
