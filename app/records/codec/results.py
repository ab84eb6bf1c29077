"""The `results` row of a calibration or a refusal, and a calibration back from it.

`state` is the float64 vector of `_STATE_LAYOUT`, little endian.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from app.records.codec.document import calibration_document
from app.records.codec.outcome import Provenance
from app.records.codec.points import decode_points, decode_residuals, encode_markers, encode_points
from app.records.codec.remarks import decode_advisories, encode_advisories, encode_quality
from core.calibration.result import Calibration, CameraPose, Observability, Reprojection
from core.camera import Camera
from core.targets.specification import GridPoints, TargetSpec

_STATE_LAYOUT: tuple[tuple[str, tuple[int, ...]], ...] = (
    ("camera", (9,)),
    ("T_camera_target", (4, 4)),
    ("covariance", (15, 15)),
    ("position_mm", (3,)),
    ("rotation", (3, 3)),
    ("roll_pitch_yaw", (3,)),
    ("roll_pitch_yaw_standard_uncertainty", (3,)),
    ("pose_covariance", (6, 6)),
    ("conditional_covariance", (6, 6)),
    ("reprojection", (4,)),
    ("observability", (3,)),
    ("pose_ambiguity_ratio", ()),  # NaN for none; the last, since states stored before it end here
)


def encode_calibration(calibration: Calibration, provenance: Provenance) -> dict[str, Any]:
    """Return the columns of the `results` row of a success."""
    return {
        "estimator": calibration.estimator,
        "calibration": calibration_document(calibration),
        "state": _encode_state(calibration),
        "points": encode_points(calibration.points, calibration.residuals_px, calibration.used),
        "markers": encode_markers(calibration.points),
        "points_warnings": encode_advisories(calibration.points.warnings),
        "origin": calibration.points.origin,
        "capture_quality": encode_quality(calibration.points.capture_quality),
        **provenance.columns(),
    }


def encode_refused(points: GridPoints | None, provenance: Provenance) -> dict[str, Any]:
    """Return the columns of the `results` row of a refusal: its points, where they were found, serve later."""
    return {
        "estimator": None,
        "calibration": None,
        "state": None,
        "points": encode_points(points) if points is not None else None,
        "markers": encode_markers(points) if points is not None else None,
        "points_warnings": encode_advisories(points.warnings) if points is not None else None,
        "origin": points.origin if points is not None else None,
        "capture_quality": encode_quality(points.capture_quality) if points is not None else None,
        **provenance.columns(),
    }


def decode_calibration(
    document: dict[str, Any],
    state: bytes,
    points: bytes,
    points_warnings: list[dict[str, Any]],
    target: TargetSpec,
    *,
    origin: str | None = None,
    capture_quality: dict[str, Any] | None = None,
) -> Calibration:
    """Return the very calibration that `encode_calibration` was given, but for its points' markers."""
    arrays = _decode_state(state)
    residuals_px, used = decode_residuals(points)
    width, height = document["image_width_px"], document["image_height_px"]
    rms_px, mean_px, std_px, max_px = (float(value) for value in arrays["reprojection"])
    focal_relative_uncertainty, condition_number, tilt = (float(value) for value in arrays["observability"])
    ratio = float(arrays["pose_ambiguity_ratio"])
    return Calibration(
        estimator=document["estimator"],
        start=document["start"],
        image_width_px=width,
        image_height_px=height,
        camera=Camera.from_array(arrays["camera"]),
        T_camera_target=arrays["T_camera_target"],
        covariance=arrays["covariance"],
        pose=CameraPose(
            position_mm=arrays["position_mm"],
            rotation=arrays["rotation"],
            roll_pitch_yaw=arrays["roll_pitch_yaw"],
            roll_pitch_yaw_standard_uncertainty=arrays["roll_pitch_yaw_standard_uncertainty"],
            covariance=arrays["pose_covariance"],
            conditional_covariance=arrays["conditional_covariance"],
        ),
        reprojection=Reprojection(
            rms_px=rms_px,
            mean_px=mean_px,
            std_px=std_px,
            max_px=max_px,
            points=document["reprojection"]["points"],
            rejected=document["reprojection"]["rejected"],
        ),
        observability=Observability(
            focal_relative_uncertainty=focal_relative_uncertainty,
            condition_number=condition_number,
            tilt=tilt,
            prior_dominated=tuple(document["observability"]["prior_dominated"]),
            pose_ambiguity_ratio=None if math.isnan(ratio) else ratio,
        ),
        warnings=decode_advisories(document["warnings"]),
        points=decode_points(
            points,
            points_warnings,
            target,
            width,
            height,
            origin=origin,
            capture_quality=capture_quality,
        ),
        residuals_px=residuals_px,
        used=used,
    )


def _encode_state(calibration: Calibration) -> bytes:
    pose, reprojection, observability = calibration.pose, calibration.reprojection, calibration.observability
    arrays: dict[str, Any] = {
        "camera": calibration.camera.as_array(),
        "T_camera_target": calibration.T_camera_target,
        "covariance": calibration.covariance,
        "position_mm": pose.position_mm,
        "rotation": pose.rotation,
        "roll_pitch_yaw": pose.roll_pitch_yaw,
        "roll_pitch_yaw_standard_uncertainty": pose.roll_pitch_yaw_standard_uncertainty,
        "pose_covariance": pose.covariance,
        "conditional_covariance": pose.conditional_covariance,
        "reprojection": (reprojection.rms_px, reprojection.mean_px, reprojection.std_px, reprojection.max_px),
        "observability": (
            observability.focal_relative_uncertainty,
            observability.condition_number,
            observability.tilt,
        ),
        "pose_ambiguity_ratio": math.nan
        if observability.pose_ambiguity_ratio is None
        else observability.pose_ambiguity_ratio,
    }
    parts = [np.asarray(arrays[name], dtype="<f8").reshape(shape).tobytes() for name, shape in _STATE_LAYOUT]
    return b"".join(parts)


def _decode_state(state: bytes) -> dict[str, Float[np.ndarray, "..."]]:
    values = np.frombuffer(state, dtype="<f8")
    arrays, offset = {}, 0
    for name, shape in _STATE_LAYOUT:
        size = math.prod(shape)
        stored = values[offset : offset + size]
        arrays[name] = stored.reshape(shape).copy() if len(stored) == size else np.full(shape, np.nan)
        offset += size
    return arrays
