"""The `results` row of a calibration or a refusal, and the document of a calibration as the API shows it."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np

from app.records.codec.points import content_hash, encode_markers, encode_points
from app.records.outcome import Provenance
from core.calibration import Calibration
from core.errors import Advisory
from core.geometry import CAMERA_PARAMETERS
from core.targets import CaptureQuality, GridPoints


def encode_calibration(calibration: Calibration, provenance: Provenance) -> dict[str, Any]:
    """Return the columns of the `results` row of a success."""
    points = encode_points(calibration.points, calibration.residuals_px, calibration.used)
    markers = encode_markers(calibration.points)
    return {
        "estimator": calibration.estimator,
        "calibration": calibration_document(calibration),
        "points": points,
        "markers": markers,
        "content_sha256": content_hash(points, markers),
        "points_warnings": encode_advisories(calibration.points.warnings),
        "labelling": calibration.points.labelling,
        "capture_quality": encode_quality(calibration.points.capture_quality),
        **provenance.columns(),
    }


def encode_refused(points: GridPoints | None, provenance: Provenance) -> dict[str, Any]:
    """Return the columns of the `results` row of a refusal: its points, where they were found, serve later."""
    encoded = encode_points(points) if points is not None else None
    markers = encode_markers(points) if points is not None else None
    return {
        "estimator": None,
        "calibration": None,
        "points": encoded,
        "markers": markers,
        "content_sha256": content_hash(encoded, markers),
        "points_warnings": encode_advisories(points.warnings) if points is not None else None,
        "labelling": points.labelling if points is not None else None,
        "capture_quality": encode_quality(points.capture_quality) if points is not None else None,
        **provenance.columns(),
    }


def calibration_document(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration as the API shows it: degrees where a name says so, no NaN anywhere."""
    camera = dict(zip(CAMERA_PARAMETERS, calibration.camera.as_array().tolist(), strict=True))
    uncertainty = calibration.camera_standard_uncertainty.tolist()
    fx_interval, fy_interval = calibration.focal_interval_95
    pose = calibration.pose
    roll, pitch, yaw = np.degrees(pose.roll_pitch_yaw).tolist()
    position_uncertainty = np.sqrt(np.diag(pose.covariance)[:3]).tolist()
    angle_uncertainty = np.degrees(pose.roll_pitch_yaw_standard_uncertainty).tolist()
    reprojection, observability = calibration.reprojection, calibration.observability
    return {
        "estimator": calibration.estimator,
        "initialisation": calibration.initialisation,
        "grade": calibration.grade,
        "image_width_px": calibration.image_width_px,
        "image_height_px": calibration.image_height_px,
        "intrinsics": {name: camera[name] for name in CAMERA_PARAMETERS[:4]},
        "distortion": {name: camera[name] for name in CAMERA_PARAMETERS[4:]},
        "standard_uncertainty": dict(zip(CAMERA_PARAMETERS, uncertainty, strict=True)),
        "interval_95": {"fx_px": list(fx_interval), "fy_px": list(fy_interval)},
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
            "covariance_given_camera": pose.covariance_given_camera.tolist(),
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
            "ambiguity_log_likelihood_ratio": observability.ambiguity_log_likelihood_ratio,
        },
        "warnings": encode_advisories(calibration.warnings),
    }


def encode_advisories(advisories: tuple[Advisory, ...]) -> list[dict[str, Any]]:
    """Return warnings or advice as the API shows them."""
    return [{"code": a.code, "detail": a.detail, "advice": a.advice} for a in advisories]


def encode_quality(quality: CaptureQuality | None) -> dict[str, Any] | None:
    """Return the value's own fields, angles in radians; null for values that are not finite, which JSON lacks."""
    if quality is None:
        return None
    values = {field.name: getattr(quality, field.name) for field in fields(quality) if field.name != "advice"}
    return {
        **{
            name: float(value) if value is not None and math.isfinite(value) else None
            for name, value in values.items()
        },
        "advice": encode_advisories(quality.advice),
    }
