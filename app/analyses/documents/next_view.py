"""The most informative next views for a session's camera, mount or robot as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from app.analyses.documents.camera.camera_files import chosen_group
from app.analyses.documents.dh import check_plan_size
from app.analyses.documents.encoding import limits_of
from app.analyses.documents.findings import Findings
from app.analyses.documents.view_words import instruction
from app.analyses.outcome import AnalysisError
from core.calibration import CommonFit
from core.errors import Advisory, JointAnglesInconsistent, NominalRobotMissing, TooFewMeasurements
from core.geometry import camera_from_array, invert, project_any, transform_points
from core.session import (
    FocusGroup,
    SessionData,
    SessionEstimate,
    common_fit,
    estimate_session,
    suggest_dh_views,
    suggest_hand_eye_views,
    suggest_views,
    views_of_candidates,
    with_nominal_orientations,
)
from core.targets import TargetSpec

MAX_LISTED = 10


@dataclass(frozen=True)
class _Views:
    """Views to take with what each leaves uncertain, from what is uncertain now on; `stated` as `RobotCandidates`."""

    T_camera_target: Float[np.ndarray, "n 4 4"]
    T_base_flange: Float[np.ndarray, "n 4 4"] | None
    joint_angles: Float[np.ndarray, "n j"] | None
    left: list[dict[str, float | None]]
    stated: Int[np.ndarray, " k"] | None


def next_view_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `POST .../next-view` answers."""
    purpose, count = settings["purpose"], int(settings["count"])
    _require_images(data, purpose)
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
    asked = json.loads(settings.get("candidates", "null"))
    stated = None if asked is None else _model_angles(data, asked, spec)
    if purpose == "intrinsics":
        views = _camera_views(data, estimate, group, target, count, stated)
    else:
        limits = None if data.nominal is None else np.radians(limits_of(settings))
        suggest = suggest_hand_eye_views if purpose == "hand_eye" else suggest_dh_views
        robot = suggest(data, estimate, group, target, count, stated, limits)
        left = [
            _uncertainty(length_rms_mm=position, angle_rms_deg=math.degrees(angle))
            for position, angle in zip(robot.position_mm, robot.angle, strict=True)
        ]
        views = _Views(robot.T_camera_target, robot.T_base_flange, robot.joint_angles, left, robot.stated)
    fields = {
        "purpose": purpose,
        "focus_group": group.name,
        "target_id": target_id,
        "suggestions": [
            {
                "T_target_camera": invert(T).tolist(),
                "T_base_flange": None if views.T_base_flange is None else views.T_base_flange[place].tolist(),
                "joint_angles_deg": _stated_angles(data, views, place),
                **_described(T, spec, fit),
                "expected_uncertainty_now": views.left[place],
                "expected_uncertainty_after": views.left[place + 1],
            }
            for place, T in enumerate(views.T_camera_target)
        ],
    }
    hidden = [] if views.stated is None or asked is None else _hidden(len(asked), views.stated)
    return Findings(fields, estimate.excluded.values(), [*estimate.warnings, *hidden])


def _require_images(data: SessionData, purpose: str) -> None:
    """Raise TooFewMeasurements for poses of another instrument alone: advice to take images is for a camera."""
    if data.pending or not data.measured_instead:
        return
    robot = (
        "For the robot, measure poses that move all joints over their whole range; `observability_indices`, "
        "`null_space` and the parameters' uncertainties of `dh` (source=measured_poses) say what is still missing. "
    )
    raise TooFewMeasurements(
        "The session has poses that another instrument measured, and no images: next views are those of a camera.",
        f"{robot if purpose == 'dh' else ''}A camera's views are suggested in a session of its images; "
        "`gridpose robots plan dh` plans them before there are any.",
    )


def _model_angles(
    data: SessionData, stated_deg: list[list[float]], spec: TargetSpec
) -> Float[np.ndarray, "n j"]:
    """Return the candidates' joint angles as the robot's model has them, rad."""
    check_plan_size(len(stated_deg), spec.columns, spec.rows)
    if data.nominal is None:
        raise NominalRobotMissing("Joint angles are no views without the robot's model.")
    for number, angles in enumerate(stated_deg, 1):
        if len(angles) != len(data.nominal):
            raise JointAnglesInconsistent(
                f"Candidate {number} has {len(angles)} joint angles, the robot {len(data.nominal)} joints."
            )
    return data.model_angles(np.array(stated_deg, dtype=np.float64))


def _camera_views(
    data: SessionData,
    estimate: SessionEstimate,
    group: FocusGroup,
    target: int,
    count: int,
    stated: Float[np.ndarray, "n j"] | None,
) -> _Views:
    at = None if stated is None else views_of_candidates(data, estimate, group, target, stated)
    fit, covariance = common_fit(group), group.estimate.camera_covariance
    shown = None if at is None else at.T_camera_target
    found = suggest_views(fit, covariance, data.targets[target], count, shown)
    left = [
        _uncertainty(projection_rms_px=pixels, focal_relative_uncertainty=focal)
        for pixels, focal in zip(found.projection_px, found.focal_relative, strict=True)
    ]
    if at is None or at.joint_angles is None:
        return _Views(found.T_camera_target, None, None, left, None)
    flange, q = at.T_base_flange[found.places], at.joint_angles[found.places]
    return _Views(found.T_camera_target, flange, q, left, at.stated)


def _hidden(asked: int, shown: Int[np.ndarray, " k"]) -> list[Advisory]:
    """Warn of the candidates, by their number from 1, that do not show the whole target."""
    known = set(shown.tolist())
    numbers = [str(number + 1) for number in range(asked) if number not in known]
    if not numbers:
        return []
    listed = ", ".join(numbers[:MAX_LISTED]) + (" ..." if len(numbers) > MAX_LISTED else "")
    return [
        Advisory(
            "candidates_hide_target",
            f"{len(numbers)} of {asked} candidates do not show the whole target: {listed}.",
            "Views are chosen of the others; leave these out, or bring the camera's view back onto the target.",
        )
    ]


def _uncertainty(**known: float) -> dict[str, float | None]:
    """Return all fields of an uncertainty: those known of a purpose, null for the others."""
    names = ("projection_rms_px", "focal_relative_uncertainty", "length_rms_mm", "angle_rms_deg")
    return {name: float(known[name]) if name in known else None for name in names}


def _stated_angles(data: SessionData, views: _Views, place: int) -> list[float] | None:
    """Return joint angles as the robot states them, degrees."""
    if views.joint_angles is None:
        return None
    angles = views.joint_angles[place]
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
