"""The camera of a session, focus group by focus group, and how its targets lie to one another."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float

from app.services.analyses.documents import advisories, camera_fields
from app.services.analyses.estimation import EstimatedImage, estimate_session, worst_images
from app.services.analyses.refined_target import refine_target
from app.services.analyses.snapshot import Snapshot
from core.transforms import hat, transform, transform_mean


def intrinsics_document(
    snapshot: Snapshot, points: Mapping[str, bytes], settings: Mapping[str, str]
) -> dict[str, Any]:
    """Return what `GET .../intrinsics` answers, but for the fields every analysis has."""
    session = estimate_session(snapshot, points, settings["estimator"])
    groups, images, shape, warnings = session.groups, session.images, None, session.warnings
    if settings.get("refine_target") == "true":
        refined = refine_target(snapshot, points, session)
        groups, images, shape = refined.groups, refined.images, refined.shape
        warnings = (*warnings, *refined.warnings)
    return {
        "estimator": settings["estimator"],
        "groups": [
            {
                **camera_fields(group),
                "covariance": group.estimate.camera_covariance.tolist(),
                "worst": [
                    {"measurement_id": e.image.measurement_id, "rms_px": e.rms_px}
                    for e in worst_images(group)
                ],
            }
            for group in groups
        ],
        "target_transforms": _target_transforms(snapshot, images),
        "target_shape": shape,
        "warnings": advisories(warnings),
    }


def _target_transforms(snapshot: Snapshot, images: tuple[EstimatedImage, ...]) -> list[dict[str, Any]]:
    """Return T_from_to of every two targets that some images show together."""
    seen: dict[tuple[str, str], dict[int, EstimatedImage]] = {}
    for e in images:
        seen.setdefault((e.image.pose_id, e.image.sha256), {})[e.image.target] = e
    documents = []
    for first, second in combinations(range(len(snapshot.targets)), 2):
        pairs = [(both[first], both[second]) for both in seen.values() if first in both and second in both]
        if not pairs:
            continue
        mean = transform_mean(np.array([_relative(a, b) for a, b in pairs]))
        # The lens's part of the doubt is common to all images, so that more of them do not lessen it.
        covariance = np.mean([_relative_covariance(a, b) for a, b in pairs], axis=0)
        documents.append(
            {
                "from_target_id": snapshot.target_ids[first],
                "to_target_id": snapshot.target_ids[second],
                "T_from_to": mean.tolist(),
                "covariance": covariance.tolist(),
                "images": len(pairs),
            }
        )
    return documents


def _relative(a: EstimatedImage, b: EstimatedImage) -> Float[np.ndarray, "4 4"]:
    """Return T_a_b = T_a_camera T_camera_b."""
    rotation = a.rotation @ b.rotation.T
    return transform(rotation, a.position_mm - rotation @ b.position_mm)


def _relative_covariance(a: EstimatedImage, b: EstimatedImage) -> Float[np.ndarray, "6 6"]:
    """Propagate both poses' covariances: w = w_a - R w_b, d = d_a - R d_b + [R p_b]× w, with R = R_a R_bᵀ."""
    rotation = a.rotation @ b.rotation.T
    arm = hat(rotation @ b.position_mm)
    J = np.zeros((6, 12))
    J[:3, :3] = J[3:, 3:6] = np.eye(3)
    J[:3, 6:9] = J[3:, 9:] = -rotation
    J[:3, 3:6], J[:3, 9:] = arm, -arm @ rotation
    both = np.zeros((12, 12))
    both[:6, :6], both[6:, 6:] = a.covariance, b.covariance
    return np.asarray(J @ both @ J.T)
