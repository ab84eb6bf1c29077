"""The most informative next views of a session's camera as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from app.analyses.documents.camera.camera_files import chosen_group
from app.analyses.documents.findings import Findings
from app.analyses.outcome import AnalysisError
from core.geometry import AnyCamera, invert, project_any, transform_points
from core.session import SessionData, estimate_session, suggest_views
from core.targets import TargetSpec


def next_view_findings(data: SessionData, settings: Mapping[str, str]) -> Findings:
    """Return what `POST .../next-view` answers."""
    estimate = estimate_session(data, "pooled")
    group = chosen_group(data, estimate.groups, settings.get("focus_group"))
    fit = group.estimate.fit
    if fit is None:
        raise AnalysisError(
            "too_few_measurements",
            "The images so far give no common camera to plan from.",
            "Take three images from different directions first, the target tilted by 30° or more.",
        )
    target_id = settings.get("target_id", data.target_ids[0])
    if target_id not in data.target_ids:
        raise AnalysisError(
            "target_not_in_session",
            "The session does not look at this target.",
            "Name one of its targets.",
        )
    spec = data.targets[data.target_ids.index(target_id)]
    found = suggest_views(fit, group.estimate.camera_covariance, spec, int(settings["count"]))
    left = [
        {"projection_rms_px": pixels, "focal_relative_uncertainty": focal}
        for pixels, focal in zip(found.projection_px.tolist(), found.focal_relative.tolist(), strict=True)
    ]
    fields = {
        "purpose": "intrinsics",
        "focus_group": group.name,
        "target_id": target_id,
        "suggestions": [
            {
                "T_target_camera": invert(T).tolist(),
                "joint_angles_deg": None,
                **_described(T, spec, group.estimate.camera),
                "expected_uncertainty_now": left[place],
                "expected_uncertainty_after": left[place + 1],
            }
            for place, T in enumerate(found.T_camera_target)
        ],
    }
    return Findings(fields, estimate.excluded.values(), estimate.warnings)


def _described(T: Float[np.ndarray, "4 4"], spec: TargetSpec, camera: AnyCamera) -> dict[str, Any]:
    """Return a view in words of a camera's user: distance, tilt, where the target's middle is."""
    middle = transform_points(T, spec.points_target().mean(axis=0)[None])
    pixel = project_any(middle, camera)[0]
    return {
        "view_distance_mm": float(np.linalg.norm(middle)),
        "view_tilt_deg": math.degrees(math.acos(min(max(float(T[2, 2]), -1.0), 1.0))),
        "target_middle_px": pixel.tolist(),
    }
