"""A calibration as a row, and back again without loss.

The row holds the document the API shows (degrees, named fields) and, beside it, the arrays as bytes: `state` is the
float64 vector of `_STATE_LAYOUT`, little endian; `points` one `_POINT` record per grid point; `markers` one `_MARKER`
record per marker seen, ascending by id; `capture_quality` that value's fields, angles in radians. Analyses over
thousands of rows read these and never open an image again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from core.calibration.result import Calibration, CameraPose, Observability, Reprojection
from core.calibration.view_stack import ViewStack
from core.camera import CAMERA_PARAMETERS, Camera
from core.errors import Advisory
from core.targets.capture_quality import CaptureQuality
from core.targets.specification import GridPoints, Origin, TargetSpec

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
_POINT = np.dtype(
    [
        ("column", "<i2"),
        ("row", "<i2"),
        ("u_px", "<f8"),
        ("v_px", "<f8"),
        ("standard_uncertainty_px", "<f8"),
        ("residual_u_px", "<f8"),
        ("residual_v_px", "<f8"),
        ("used", "i1"),
    ]
)
_MARKER = np.dtype([("id", "<i4"), ("corners_px", "<f8", (4, 2))])
_ORIGINS: dict[str | None, Origin] = {
    None: "known",
    "known": "known",
    "turned": "turned",
    "unknown": "unknown",
}
_UNKNOWN = -1  # `used` of a point no fit has looked at; its residuals are NaN


@dataclass(frozen=True, slots=True)
class Failure:
    """Why an image gave no calibration."""

    code: str
    detail: str
    advice: str | None


@dataclass(frozen=True, slots=True)
class Shown:
    """A target that an image was searched for and shows: the columns of its `results` row, and the failure, if one.

    `duration_ms` is what it alone took, without decoding and searching.
    """

    target_id: str
    result: dict[str, Any]
    failure: Failure | None
    duration_ms: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a job brings back: the columns of its `results` row, if any, and the failure, if one.

    Of an image that was searched for several targets these are what holds where the row's own is not among those
    `shown`, which are in the session's order.
    """

    result: dict[str, Any] | None
    failure: Failure | None
    shown: tuple[Shown, ...] = ()


@dataclass(frozen=True, slots=True)
class Provenance:
    """What a result was computed from and with: enough to compute it again."""

    core_version: str
    input_sha256: str
    settings: dict[str, Any]

    def columns(self) -> dict[str, Any]:
        """Return the columns of the `results` row."""
        return {
            "core_version": self.core_version,
            "input_sha256": self.input_sha256,
            "settings": self.settings,
        }


def encode_calibration(calibration: Calibration, provenance: Provenance) -> dict[str, Any]:
    """Return the columns of the `results` row of a success."""
    return {
        "estimator": calibration.estimator,
        "calibration": calibration_document(calibration),
        "state": _encode_state(calibration),
        "points": _encode_points(calibration.points, calibration.residuals_px, calibration.used),
        "markers": _encode_markers(calibration.points),
        "points_warnings": _advisories(calibration.points.warnings),
        "origin": calibration.points.origin,
        "capture_quality": _encode_quality(calibration.points.capture_quality),
        **provenance.columns(),
    }


def encode_refused(points: GridPoints | None, provenance: Provenance) -> dict[str, Any]:
    """Return the columns of the `results` row of a refusal: its points, where they were found, serve later."""
    return {
        "estimator": None,
        "calibration": None,
        "state": None,
        "points": _encode_points(points, None, None) if points is not None else None,
        "markers": _encode_markers(points) if points is not None else None,
        "points_warnings": _advisories(points.warnings) if points is not None else None,
        "origin": points.origin if points is not None else None,
        "capture_quality": _encode_quality(points.capture_quality) if points is not None else None,
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
    records = np.frombuffer(points, dtype=_POINT)
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
        warnings=tuple(Advisory(**warning) for warning in document["warnings"]),
        points=decode_points(
            points,
            points_warnings,
            target,
            width,
            height,
            origin=origin,
            capture_quality=capture_quality,
        ),
        residuals_px=np.stack([records["residual_u_px"], records["residual_v_px"]], axis=1),
        used=records["used"] == 1,
    )


def decode_points(
    points: bytes,
    warnings: list[dict[str, Any]],
    target: TargetSpec,
    width_px: int,
    height_px: int,
    *,
    origin: str | None = None,
    capture_quality: dict[str, Any] | None = None,
) -> GridPoints:
    """Return the grid points of a stored result, but for their markers.

    `origin` is null in results of the time before it was kept, when every grid's was known or one of its turns'.
    """
    records = np.frombuffer(points, dtype=_POINT)
    return GridPoints(
        target=target,
        image_width_px=width_px,
        image_height_px=height_px,
        column=records["column"].astype(np.intp),
        row=records["row"].astype(np.intp),
        points_px=np.stack([records["u_px"], records["v_px"]], axis=1),
        standard_uncertainty_px=records["standard_uncertainty_px"].copy(),
        warnings=tuple(Advisory(**warning) for warning in warnings),
        origin=_ORIGINS[origin],
        capture_quality=decode_quality(capture_quality) if capture_quality is not None else None,
    )


def decode_stack(
    points: Sequence[bytes],
    targets: Sequence[TargetSpec],
    target: Sequence[int],
    width_px: int,
    height_px: int,
) -> ViewStack:
    """Return the grid points of many stored results of one image size; `target` is each one's place in `targets`."""
    records = np.frombuffer(b"".join(points), dtype=_POINT)
    counts = np.array([len(stored) // _POINT.itemsize for stored in points], dtype=np.intp)
    column, row = records["column"].astype(np.intp), records["row"].astype(np.intp)
    if len(set(target)) == 1:
        places = targets[target[0]].points_target(column, row)
    else:
        of_point = np.repeat(np.array(target, dtype=np.intp), counts)
        places = np.empty((len(records), 3))
        for k in set(target):
            shown = of_point == k
            places[shown] = targets[k].points_target(column[shown], row[shown])
    return ViewStack(
        image_width_px=width_px,
        image_height_px=height_px,
        targets=tuple(targets),
        target=np.array(target, dtype=np.intp),
        first=np.concatenate([[0], np.cumsum(counts)]),
        column=column,
        row=row,
        points_px=np.stack([records["u_px"], records["v_px"]], axis=1),
        standard_uncertainty_px=records["standard_uncertainty_px"].copy(),
        points_target=places,
    )


def decode_quality(capture_quality: dict[str, Any]) -> CaptureQuality:
    """Return the capture quality of a stored result; angles in radians."""
    advice = tuple(Advisory(**one) for one in capture_quality["advice"])
    return CaptureQuality(**{**capture_quality, "advice": advice})


def end_points(points: Sequence[bytes]) -> tuple[Int[np.ndarray, "m 2 2"], Float[np.ndarray, "m 2 2"]]:
    """Return column and row, and u and v (px), of the first and the last point of stored results that have points."""
    size = _POINT.itemsize
    records = np.frombuffer(b"".join(end for p in points for end in (p[:size], p[-size:])), dtype=_POINT)
    cells = np.stack([records["column"], records["row"]], axis=1).astype(np.intp)
    return cells.reshape(-1, 2, 2), np.stack([records["u_px"], records["v_px"]], axis=1).reshape(-1, 2, 2)


def rename_points(points: bytes, column: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]) -> bytes:
    """Return stored points under other names, row by row as a detector lists them."""
    records = np.frombuffer(points, dtype=_POINT).copy()
    records["column"], records["row"] = column, row
    return records[np.lexsort((column, row))].tobytes()


def decode_markers(markers: bytes) -> dict[int, Float[np.ndarray, "4 2"]]:
    """Return the corners (px) of the markers of a stored result, by their ids."""
    records = np.frombuffer(markers, dtype=_MARKER)
    return dict(zip(records["id"].tolist(), records["corners_px"].astype(np.float64), strict=True))


def points_documents(points: bytes) -> list[dict[str, Any]]:
    """Return stored points as the API shows them: every point found, rejected ones too."""
    names = _POINT.names or ()
    documents = []
    for record in np.frombuffer(points, dtype=_POINT).tolist():
        document = dict(zip(names, record, strict=True))
        if document["used"] == _UNKNOWN:
            document.update(residual_u_px=None, residual_v_px=None, used=None)
        else:
            document["used"] = document["used"] == 1
        documents.append(document)
    return documents


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
        "warnings": _advisories(calibration.warnings),
    }


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


def _encode_points(points: GridPoints, residuals_px: Any, used: Any) -> bytes:
    records = np.zeros(len(points), dtype=_POINT)
    records["column"], records["row"] = points.column, points.row
    records["u_px"], records["v_px"] = points.points_px[:, 0], points.points_px[:, 1]
    records["standard_uncertainty_px"] = points.standard_uncertainty_px
    if residuals_px is None:
        records["residual_u_px"] = records["residual_v_px"] = np.nan
        records["used"] = _UNKNOWN
    else:
        records["residual_u_px"], records["residual_v_px"] = residuals_px[:, 0], residuals_px[:, 1]
        records["used"] = used
    return records.tobytes()


def _encode_markers(points: GridPoints) -> bytes | None:
    if points.markers_px is None:
        return None
    records = np.zeros(len(points.markers_px), dtype=_MARKER)
    for record, (marker, corners) in zip(records, sorted(points.markers_px.items()), strict=True):
        record["id"], record["corners_px"] = marker, corners
    return records.tobytes()


def _encode_quality(quality: CaptureQuality | None) -> dict[str, Any] | None:
    """Return the value's own fields, with null for what is not finite, which JSON has no word for."""
    if quality is None:
        return None
    figures = {
        field.name: getattr(quality, field.name) for field in fields(quality) if field.name != "advice"
    }
    return {
        **{
            name: float(value) if value is not None and math.isfinite(value) else None
            for name, value in figures.items()
        },
        "advice": _advisories(quality.advice),
    }


def _advisories(advisories: tuple[Advisory, ...]) -> list[dict[str, Any]]:
    return [{"code": a.code, "detail": a.detail, "advice": a.advice} for a in advisories]
