"""Rows as the API's documents."""

from __future__ import annotations

from typing import Any

from app.api.schemas.measurements import MeasurementRead, PoseRead
from app.api.schemas.resources import SessionRead
from app.records.tables import Measurement, Pose
from app.services.sessions import SessionView


def session_document(view: SessionView) -> SessionRead:
    """Return a session with its counts."""
    session = view.session
    return SessionRead.model_validate(
        {
            "id": session.id,
            "name": session.name,
            "target_ids": [target.target_id for target in session.targets],
            "robot_id": session.robot_id,
            "lens": session.lens,
            "intrinsics": session.intrinsics,
            "created_at": session.created_at,
            "counts": view.counts,
        }
    )


def pose_document(pose: Pose) -> PoseRead:
    """Return a pose."""
    return PoseRead.model_validate(pose)


def measurement_document(
    measurement: Measurement, points: list[dict[str, Any]] | None = None
) -> MeasurementRead:
    """Return a measurement with its calibration or failure, and with `points` where they were asked for."""
    failure = None
    if measurement.failure_code is not None:
        failure = {
            "code": measurement.failure_code,
            "detail": measurement.failure_detail,
            "advice": measurement.failure_advice,
        }
    return MeasurementRead.model_validate(
        {
            "id": measurement.id,
            "session_id": measurement.session_id,
            "pose_id": measurement.pose_id,
            "cycle": measurement.cycle,
            "target_id": measurement.target_id,
            "siblings": [],
            "focus_group": measurement.focus_group,
            "joint_angles_deg": measurement.joint_angles_deg,
            "captured_at": measurement.captured_at,
            "received_at": measurement.received_at,
            "finished_at": measurement.finished_at,
            "sha256": measurement.sha256,
            "filename": measurement.filename,
            "bytes": measurement.bytes,
            "status": measurement.status,
            "attempts": measurement.attempts,
            "duration_ms": measurement.duration_ms,
            "failure": failure,
            "calibration": measurement.result.calibration if measurement.result is not None else None,
            "points": points,
        }
    )
