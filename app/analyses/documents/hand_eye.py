"""The camera on the flange and the targets in the base, or a fixed camera in the base, as the API shows them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from app.analyses.documents.encoding import mounted_frames, refined_estimate
from app.analyses.documents.findings import Findings
from core.session import HandEyeStation, HeldOut, SessionData, calibrate_session_hand_eye


def hand_eye_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `GET .../hand-eye` answers."""
    found = calibrate_session_hand_eye(data, refined_estimate(data, settings))
    tie = found.calibration
    fields = {
        "estimator": settings["estimator"],
        **mounted_frames(
            (tie.T_flange_camera, found.covariance[:6, :6]),
            [
                (
                    {
                        "target_id": data.target_ids[target],
                        "pose_count": sum(station.target == target for station in found.stations),
                    },
                    tie.T_base_targets[k],
                    found.covariance[6 + 6 * k : 12 + 6 * k, 6 + 6 * k : 12 + 6 * k],
                )
                for k, target in enumerate(found.targets)
            ],
            found.camera_mount,
        ),
        "coverage_factor": tie.coverage_factor,
        "robot_scatter_mm": tie.robot_position_mm,
        "robot_scatter_deg": math.degrees(tie.robot_rotation),
        "distance_scale": None
        if tie.scale is None
        else {
            "difference": tie.scale.value,
            "difference_standard_uncertainty": tie.scale.standard_uncertainty,
        },
        "residuals": [_residual(station, data) for station in found.stations],
        "residual": _rms(found.residual),
        "validation": {"pose_count": found.validation.poses, **_rms(found.validation)}
        if found.validation
        else None,
        "excluded_poses": [
            {"pose_id": one.pose_id, "code": one.code, "detail": one.detail} for one in found.excluded
        ],
    }
    return Findings(fields, found.excluded_measurements, found.warnings)


def _residual(station: HandEyeStation, data: SessionData) -> dict[str, Any]:
    d = station.deviation
    held_out = None
    if d.held_out_position_mm is not None and d.held_out_rotation is not None:
        held_out = _deviation(d.held_out_position_mm, d.held_out_rotation)
    return {
        "pose_id": station.pose_id,
        "target_id": data.target_ids[station.target],
        "image_count": station.visits,
        "used": d.used,
        "fitted_deviation": _deviation(d.position_mm, d.rotation),
        "held_out_deviation": held_out,
    }


def _deviation(position_mm: Float[np.ndarray, "3"], rotation: Float[np.ndarray, "3"]) -> dict[str, Any]:
    return {
        "position_mm": position_mm.tolist(),
        "rotation_deg": np.degrees(rotation).tolist(),
        "distance_mm": float(np.linalg.norm(position_mm)),
        "angle_deg": math.degrees(float(np.linalg.norm(rotation))),
    }


def _rms(found: HeldOut) -> dict[str, Any]:
    return {
        "position_rms_mm": found.position_rms_mm,
        "rotation_rms_deg": math.degrees(found.rotation_rms),
    }
