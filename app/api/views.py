"""Rows as the API's documents."""

from __future__ import annotations

import math
from typing import Any

from app.api.schemas.measurements import MeasurementRead, PoseRead
from app.api.schemas.resources import SessionRead
from app.records.tables import Measurement, Pose
from app.services.measurements import MeasurementView
from app.services.sessions import SessionView

_PLAIN_FIGURES = (
    "edge_width_px",
    "motion_blur_px",
    "saturated_fraction",
    "clipped_fraction",
    "contrast",
    "coverage_fraction",
)


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
    view: MeasurementView, points: list[dict[str, Any]] | None = None
) -> MeasurementRead:
    """Return a measurement with its calibration or failure, and with `points` where they were asked for."""
    measurement, result = view.measurement, view.measurement.result
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
            "siblings": view.siblings,
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
            "calibration": result.calibration if result is not None else None,
            "origin": result.origin if result is not None else None,
            "capture_quality": quality_document(measurement),
            "points": points,
        }
    )


def quality_document(measurement: Measurement) -> dict[str, Any] | None:
    """Return how well a measurement's picture was taken, in the API's units; None where that is not known."""
    stored = measurement.result.capture_quality if measurement.result is not None else None
    if stored is None:
        return None
    direction, tilt = stored["motion_blur_direction"], stored["tilt"]
    return {
        **{name: stored[name] for name in _PLAIN_FIGURES},
        "motion_blur_direction_deg": math.degrees(direction) if direction is not None else None,
        "tilt_deg": math.degrees(tilt) if tilt is not None else None,
        "advice": stored["advice"],
    }
