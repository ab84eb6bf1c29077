"""The most informative next views for a session's camera, mount or robot as JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from app.analyses.documents.camera.camera_files import chosen_group
from app.analyses.documents.findings import Findings
from app.analyses.documents.view_words import instruction
from app.analyses.outcome import AnalysisError
from core.calibration import CommonFit
from core.geometry import camera_from_array, invert, project_any, transform_points
from core.session import (
    FocusGroup,
    NextRobotViews,
    SessionData,
    SessionEstimate,
    common_fit,
    estimate_session,
    suggest_dh_views,
    suggest_hand_eye_views,
    suggest_views,
    with_nominal_orientations,
)
from core.targets import TargetSpec

_ROBOT_VIEWS: Mapping[str, Callable[[SessionData, SessionEstimate, FocusGroup, int, int], NextRobotViews]] = {
    "hand_eye": suggest_hand_eye_views,
    "dh": suggest_dh_views,
}


def next_view_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `POST .../next-view` answers."""
    purpose, count = settings["purpose"], int(settings["count"])
    seen = with_nominal_orientations(data) if purpose == "dh" else data
    estimate = estimate_session(seen, "pooled", weak=purpose == "intrinsics")
    group = chosen_group(data, estimate.groups, settings.get("focus_group"))
    fit = common_fit(group)
    target_id = settings.get("target_id", data.target_ids[0])
    if target_id not in data.target_ids:
        raise AnalysisError(
            "target_not_in_session",
            "The session does not look at this target.",
            "Name one of its targets.",
        )
    target = data.target_ids.index(target_id)
    spec = data.targets[target]
    if purpose == "intrinsics":
        of_camera = suggest_views(fit, group.estimate.camera_covariance, spec, count)
        views, robot = of_camera.T_camera_target, None
        left = [
            _uncertainty(projection_rms_px=pixels, focal_relative_uncertainty=focal)
            for pixels, focal in zip(of_camera.projection_px, of_camera.focal_relative, strict=True)
        ]
    else:
        robot = _ROBOT_VIEWS[purpose](data, estimate, group, target, count)
        views = robot.T_camera_target
        left = [
            _uncertainty(length_rms_mm=position, angle_rms_deg=math.degrees(angle))
            for position, angle in zip(robot.position_mm, robot.angle, strict=True)
        ]
    fields = {
        "purpose": purpose,
        "focus_group": group.name,
        "target_id": target_id,
        "suggestions": [
            {
                "T_target_camera": invert(T).tolist(),
                "T_base_flange": None if robot is None else robot.T_base_flange[place].tolist(),
                "joint_angles_deg": _stated_angles(data, robot, place),
                **_described(T, spec, fit),
                "expected_uncertainty_now": left[place],
                "expected_uncertainty_after": left[place + 1],
            }
            for place, T in enumerate(views)
        ],
    }
    return Findings(fields, estimate.excluded.values(), estimate.warnings)


def _uncertainty(**known: float) -> dict[str, float | None]:
    """Return all fields of an uncertainty: those known of a purpose, null for the others."""
    names = ("projection_rms_px", "focal_relative_uncertainty", "length_rms_mm", "angle_rms_deg")
    return {name: float(known[name]) if name in known else None for name in names}


def _stated_angles(data: SessionData, robot: NextRobotViews | None, place: int) -> list[float] | None:
    """Return joint angles as the robot states them, degrees."""
    if robot is None or robot.joint_angles is None:
        return None
    angles = robot.joint_angles[place]
    if data.joint_coupling is not None:
        angles = np.linalg.solve(data.joint_coupling, angles)
    return [float(angle) for angle in np.degrees(angles)]


def _described(T: Float[np.ndarray, "4 4"], spec: TargetSpec, fit: CommonFit) -> dict[str, Any]:
    """Return a view in words of a camera's user: distance, tilt, where the target's middle is."""
    camera = camera_from_array(fit.placements.parameters[0])
    middle = transform_points(T, spec.points_target().mean(axis=0)[None])
    pixel = project_any(middle, camera)[0]
    distance = float(np.linalg.norm(middle))
    return {
        "instruction": instruction(T, pixel, distance, fit),
        "view_distance_mm": distance,
        "view_tilt_deg": math.degrees(math.acos(min(max(float(T[2, 2]), -1.0), 1.0))),
        "target_middle_px": pixel.tolist(),
    }
