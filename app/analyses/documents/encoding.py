"""Parts of documents that analyses share: cameras, figures, poses, and transforms between targets."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from core.calibration import focal_interval, grade
from core.geometry import (
    CAMERA_PARAMETERS,
    LENS_PARAMETERS,
    lens_model_of,
    rotation_to_rpy,
    rpy_jacobian,
)
from core.kinematics import TargetTransform
from core.metrology import PerComponent
from core.session import (
    CameraMount,
    FocusGroup,
    SessionData,
    SessionEstimate,
    estimate_session,
    refine_target,
)

POSE_FIELDS = ("x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg")
RP = ("rp_l_mm", *(f"rp_{part}" for part in POSE_FIELDS))
AP = ("ap_p_mm", *(f"ap_{part}" for part in POSE_FIELDS))
VAP = ("vap_p_mm", *(f"vap_{part}" for part in POSE_FIELDS))
"""Keys of figures: of pose repeatability (ISO 9283:1998, 7.2.2), pose accuracy (7.2.1), multi-directional pose accuracy
variation (7.2.3)."""


def camera_fields(group: FocusGroup, covariance: Float[np.ndarray, "s s"] | None = None) -> dict[str, Any]:
    """Return a focus group's camera with its uncertainty: that of `covariance`, None the estimate's own."""
    estimate = group.estimate
    if covariance is not None:
        estimate = replace(estimate, camera_covariance=covariance)
    model = lens_model_of(estimate.camera)
    names = LENS_PARAMETERS[model]
    camera = dict(zip(names, estimate.camera.as_array().tolist(), strict=True))
    uncertainty = dict(
        zip(names, np.sqrt(np.maximum(np.diag(estimate.camera_covariance), 0.0)).tolist(), strict=True)
    )
    return {
        "focus_group": group.name,
        "image_count": len(group.poses),
        "lens_model": model,
        "intrinsics": {name: camera[name] for name in CAMERA_PARAMETERS[:4]},
        "distortion": {name: camera[name] for name in names[4:]},
        "standard_uncertainty": uncertainty,
        "grade": grade(estimate.focal_relative_uncertainty),
        "interval_95": {
            name: list(focal_interval(camera[name], uncertainty[name])) for name in CAMERA_PARAMETERS[:2]
        },
        "reduced_chi2": estimate.reduced_chi2,
    }


def limits_of(settings: Mapping[str, str]) -> Float[np.ndarray, "2 j"]:
    """Return the limits of a robot's stated joint angles by a request's settings, degrees; NaN where it has none."""
    pairs = [
        [math.nan if value is None else value for value in one] for one in json.loads(settings["limits"])
    ]
    return np.array(pairs, dtype=np.float64).reshape(-1, 2).T


def figures_document(
    figures: PerComponent[float | None], keys: tuple[str, ...] = RP
) -> dict[str, float | None]:
    """Return figures under the API's keys, angles in degrees."""
    return {
        name: None if value is None else factor(name) * value
        for name, (_, value) in zip(keys, figures.items(), strict=True)
    }


def intervals_document(
    intervals: PerComponent[tuple[float, float] | None], keys: tuple[str, ...] = RP
) -> dict[str, list[float] | None]:
    """Return intervals of figures under the API's keys, angles in degrees."""
    return {
        name: None if value is None else [factor(name) * value[0], factor(name) * value[1]]
        for name, (_, value) in zip(keys, intervals.items(), strict=True)
    }


def factor(name: str) -> float:
    """Return what a figure is multiplied by for the API."""
    return math.degrees(1.0) if name.endswith("_deg") else 1.0


def frame_fields(
    T: Float[np.ndarray, "4 4"], name: str, covariance: Float[np.ndarray, "6 6"] | None
) -> dict[str, Any]:
    """Return a frame as the API shows it: the transform under its name, and its pose with what is uncertain of it."""
    return {name: T.tolist(), **pose_fields(T, covariance)}


def mounted_frames(
    moving: tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 6"] | None],
    fixed: Sequence[tuple[dict[str, Any], Float[np.ndarray, "4 4"], Float[np.ndarray, "6 6"] | None]],
    mount: CameraMount,
) -> dict[str, Any]:
    """Return the frames on the flange and in the base by what they are: of a camera on the robot, or of a fixed one.

    `moving` is what is on the flange and its covariance; `fixed` are those in the base, each with the fields that name
    the target and count its poses. Of a fixed camera there is one target, which is on the flange.
    """
    if mount == "robot":
        return {
            "flange_camera": frame_fields(moving[0], "T_flange_camera", moving[1]),
            "base_targets": [
                {**of_target, **frame_fields(T, "T_base_target", C)} for of_target, T, C in fixed
            ],
            "base_camera": None,
            "flange_targets": [],
        }
    ((of_target, T, C),) = fixed
    return {
        "flange_camera": None,
        "base_targets": [],
        "base_camera": frame_fields(T, "T_base_camera", C),
        "flange_targets": [{**of_target, **frame_fields(moving[0], "T_flange_target", moving[1])}],
    }


def refined_estimate(
    data: SessionData, settings: Mapping[str, str], *, weak: bool = False
) -> SessionEstimate:
    """Return the session's estimate by the settings' estimator, before the target as it is where that is asked for;
    `weak` as in `estimate_session`.
    """
    estimate = estimate_session(data, settings["estimator"], weak=weak)
    if settings.get("refine_target") == "true":
        return refine_target(data, estimate).estimate
    return estimate


def pose_fields(T: Float[np.ndarray, "4 4"], covariance: Float[np.ndarray, "6 6"] | None) -> dict[str, Any]:
    """Return a rigid transform by its parts, with their standard uncertainties.

    `covariance` is of x, y, z (mm) and a small rotation w (rad) with R_true = exp(w) R; None where it is not known. A
    coordinate without variance is held, and has no uncertainty; the angles have none where a part of w is held.
    """
    angles = rotation_to_rpy(T[:3, :3])
    stated: dict[str, Any] = {"standard_uncertainty": None, "covariance": None}
    if covariance is not None:
        stated = {
            "standard_uncertainty": _standard_uncertainty(angles, covariance),
            "covariance": covariance.tolist(),
        }
    return {
        "position_mm": T[:3, 3].tolist(),
        "rotation": T[:3, :3].tolist(),
        **dict(zip(POSE_FIELDS[3:], np.degrees(angles).tolist(), strict=True)),
        **stated,
    }


def _standard_uncertainty(
    angles: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "6 6"]
) -> dict[str, float | None]:
    J = rpy_jacobian(angles)
    variances = np.concatenate([np.diag(covariance)[:3], np.diag(J @ covariance[3:, 3:] @ J.T)])
    uncertainty = np.sqrt(np.maximum(variances, 0.0))
    uncertainty[3:] = np.degrees(uncertainty[3:])
    known = np.diag(covariance) > 0.0
    known[3:] = known[3:].all()
    stated = zip(uncertainty.tolist(), known.tolist(), strict=True)
    return dict(zip(POSE_FIELDS, (u if known_one else None for u, known_one in stated), strict=True))


def target_transform_document(
    found: TargetTransform, data: SessionData, targets: range | tuple[int, ...]
) -> dict[str, Any]:
    """Return how two targets lie to one another; `targets` are the session's places of those that `found` counts."""
    return {
        "from_target_id": data.target_ids[targets[found.from_target]],
        "to_target_id": data.target_ids[targets[found.to_target]],
        "T_from_to": found.T_from_to.tolist(),
        "covariance": found.covariance.tolist(),
        "image_count": found.poses,
    }
