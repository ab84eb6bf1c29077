"""A calibration as the API shows it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from app.records.codec.remarks import encode_advisories
from core.calibration.result import Calibration
from core.camera import CAMERA_PARAMETERS


def calibration_document(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration as the API shows it: degrees where a name says so, no NaN anywhere."""
    camera = dict(zip(CAMERA_PARAMETERS, calibration.camera.as_array().tolist(), strict=True))
    uncertainty = calibration.camera_standard_uncertainty.tolist()
    pose = calibration.pose
    roll, pitch, yaw = np.degrees(pose.roll_pitch_yaw).tolist()
    position_uncertainty = np.sqrt(np.diag(pose.covariance)[:3]).tolist()
    angle_uncertainty = np.degrees(pose.roll_pitch_yaw_standard_uncertainty).tolist()
    reprojection, observability = calibration.reprojection, calibration.observability
    return {
        "estimator": calibration.estimator,
        "start": calibration.start,
        "image_width_px": calibration.image_width_px,
        "image_height_px": calibration.image_height_px,
        "intrinsics": {name: camera[name] for name in CAMERA_PARAMETERS[:4]},
        "distortion": {name: camera[name] for name in CAMERA_PARAMETERS[4:]},
        "standard_uncertainty": dict(zip(CAMERA_PARAMETERS, uncertainty, strict=True)),
        "T_camera_target": calibration.T_camera_target.tolist(),
        "pose": {
            "position_mm": pose.position_mm.tolist(),
            "rotation": pose.rotation.tolist(),
            "roll_deg": roll,
            "pitch_deg": pitch,
            "yaw_deg": yaw,
            "standard_uncertainty": dict(
                zip(
                    ("x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg"),
                    position_uncertainty + angle_uncertainty,
                    strict=True,
                )
            ),
            "covariance": pose.covariance.tolist(),
            "conditional_covariance": pose.conditional_covariance.tolist(),
        },
        "reprojection": {
            "rms_px": reprojection.rms_px,
            "mean_px": reprojection.mean_px,
            "std_px": reprojection.std_px,
            "max_px": reprojection.max_px,
            "points": reprojection.points,
            "rejected": reprojection.rejected,
        },
        "observability": {
            "focal_relative_uncertainty": observability.focal_relative_uncertainty,
            "condition_number": observability.condition_number,
            "tilt_deg": math.degrees(observability.tilt),
            "prior_dominated": list(observability.prior_dominated),
            "pose_ambiguity_ratio": observability.pose_ambiguity_ratio,
        },
        "warnings": encode_advisories(calibration.warnings),
    }
