"""What a report is made from, so that years later each input can be named, compared and found again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from sqlalchemy import orm

from app.analyses.inputs.snapshot import Snapshot
from app.records.tables import Measurement, Result, Robot, Session, Target

Json = dict[str, Any]
OF_TARGET = (
    *("id", "name", "kind", "columns", "rows", "pitch_mm", "marker_mm", "dictionary", "legacy_layout"),
    *("pitch_standard_uncertainty_mm", "print_kind", "shape_standard_uncertainty", "certificate"),
)
OF_ROBOT = (
    *("id", "name", "manufacturer", "model", "serial_number", "joints", "joint_coupling"),
    *("datasheet_repeatability_mm", "datasheet_accuracy_mm"),
)
OF_POSE = ("position_mm", "roll_deg", "pitch_deg", "yaw_deg", "joint_angles_deg", "approach")


def read_inputs(records: orm.Session, snapshot: Snapshot, *, with_rms: bool) -> Json:
    """Return every input of a snapshot as a report states it; `with_rms` adds each image's own residual (px)."""
    session = records.get_one(Session, snapshot.session_id)
    robot = records.get(Robot, session.robot_id) if session.robot_id is not None else None
    targets = {
        row.id: row for row in records.scalars(sa.select(Target).where(Target.id.in_(snapshot.target_ids)))
    }
    return {
        "session": {
            "id": session.id,
            "name": session.name,
            "lens": session.lens,
            "intrinsics": session.intrinsics,
            "conditions": session.conditions,
            # With the camera on the robot, the inputs are those of versions before it.
            **({} if session.camera_mount == "robot" else {"camera_mount": session.camera_mount}),
        },
        "robot": None if robot is None else {name: getattr(robot, name) for name in OF_ROBOT},
        "targets": [
            {name: getattr(targets[target_id], name) for name in OF_TARGET}
            for target_id in snapshot.target_ids
        ],
        "poses": [
            {"pose_id": pose_id, **{name: _listed(getattr(commanded, name)) for name in OF_POSE}}
            for pose_id, commanded in snapshot.commanded.items()
        ],
        "images": _images(records, snapshot, with_rms=with_rms),
        "measured_poses": [
            {
                "measurement_id": one.measurement_id,
                "pose_id": one.pose_id,
                "cycle": one.cycle,
                "content_sha256": one.content_sha256,
            }
            for one in snapshot.measured
        ],
    }


def target_row(stated: Mapping[str, Any]) -> Target:
    """Return a target as a report states it; the row is of no database."""
    return Target(**{name: stated[name] for name in OF_TARGET if name in stated})


def inputs_hash(inputs: Mapping[str, Any]) -> str:
    """Return the SHA-256 of all inputs, 64 hex digits."""
    text = json.dumps(inputs, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _images(records: orm.Session, snapshot: Snapshot, *, with_rms: bool) -> list[Json]:
    rms: dict[str, float | None] = {}
    if with_rms:
        rows = records.execute(
            sa.select(Result.measurement_id, Result.calibration)
            .join(Measurement, Measurement.id == Result.measurement_id)
            .where(Measurement.session_id == snapshot.session_id)
        )
        rms = {measurement_id: _rms(calibration) for measurement_id, calibration in rows}
    found = []
    for image in snapshot.images:
        seen = image.observation
        found.append(
            {
                "measurement_id": seen.measurement_id,
                "pose_id": seen.pose_id,
                "cycle": seen.cycle,
                **({} if seen.burst is None else {"burst": seen.burst}),
                "sha256": seen.image,
                "filename": seen.filename,
                "target_id": snapshot.target_ids[seen.target] if seen.target >= 0 else None,
                **({} if image.stated_target_id is None else {"stated_target_id": image.stated_target_id}),
                "focus_group": seen.focus_group,
                "joint_angles_deg": _listed(seen.joint_angles_deg),
                "failure_code": seen.failure_code,
                "failure_detail": seen.failure_detail,
                "content_sha256": image.content_sha256,
                "labelling": image.labelling,
                "computed_by": image.computed_by,
                "captured_at": _rfc3339(image.captured_at),
                "received_at": _rfc3339(image.received_at),
                "image_width_px": seen.width_px,
                "image_height_px": seen.height_px,
                "rms_px": rms.get(seen.measurement_id),
            }
        )
    return found


def _rms(calibration: Any) -> float | None:
    try:
        return round(float(calibration["reprojection"]["rms_px"]), 6)
    except (KeyError, TypeError, ValueError):  # no calibration, or a damaged one: a refused view has none
        return None


def _rfc3339(moment: datetime | None) -> str | None:
    return None if moment is None else moment.astimezone(UTC).isoformat().replace("+00:00", "Z")


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
