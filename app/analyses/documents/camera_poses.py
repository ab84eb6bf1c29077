"""The camera's pose of every image as the API shows it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from app.analyses.documents.encoding import pose_fields, refined_estimate
from app.analyses.documents.findings import Findings
from core.geometry import invert, transform
from core.session import ImagePose, MeasuredPose, SessionData, image_poses, with_print_uncertainty


def camera_poses_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `GET .../camera-poses` answers."""
    estimate = with_print_uncertainty(data, refined_estimate(data, settings, weak=True))
    fields = {
        "estimator": settings["estimator"],
        "camera_poses": [_image(one, data) for one in image_poses(data, estimate)],
    }
    return Findings(fields, (*estimate.excluded.values(), *estimate.unclear.values()), estimate.warnings)


def _image(one: ImagePose, data: SessionData) -> dict[str, Any]:
    image, reason = one.image, one.reason
    return {
        "measurement_id": image.measurement_id,
        "pose_id": image.pose_id,
        "cycle": image.cycle,
        "target_id": data.target_ids[image.target],
        "focus_group": image.focus_group,
        "used": one.used,
        "rejection": None if reason is None else {"code": reason.code, "detail": reason.detail},
        "focal": None
        if one.focal_px is None
        else {"focal_px": one.focal_px[0], "standard_uncertainty_px": one.focal_px[1]},
        **(
            _pose(one.pose)
            if one.pose is not None
            else {"T_camera_target": None, "pose": None, "rms_px": None}
        ),
    }


def _pose(pose: MeasuredPose) -> dict[str, Any]:
    assert pose.rotation is not None  # poses of images always have one
    assert pose.covariance is not None
    own = pose.own_covariance()
    T_target_camera = transform(pose.rotation, pose.position_mm)
    return {
        "T_camera_target": invert(T_target_camera).tolist(),
        "pose": {
            **pose_fields(T_target_camera, pose.covariance),
            "covariance_given_camera": np.asarray(own).tolist(),
        },
        "rms_px": pose.rms_px,
    }
