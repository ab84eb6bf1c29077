"""Warnings on poses that another instrument measured: which figures are null, and why."""

from __future__ import annotations

from collections.abc import Sequence

from core.errors import Advisory, listed
from core.session.model import SessionData


def measured_pose_warnings(data: SessionData) -> list[Advisory]:
    """Say which figures are null, and why."""
    poses = list(dict.fromkeys(pose.pose_id for pose in data.measured))
    positions = {pose.pose_id for pose in data.measured if pose.rotation is None}
    unknown = {pose.pose_id for pose in data.measured if pose.covariance is None}
    warnings = []
    if positions:
        warnings.append(
            Advisory(
                "rotations_missing",
                f"{_named(positions, poses)}: not every reading has a rotation, so that no figure of orientation is "
                "given.",
                "Use a probe that measures all six degrees of freedom where orientation matters.",
            )
        )
    if unknown:
        warnings.append(
            Advisory(
                "noise_unknown",
                f"{_named(unknown, poses)}: not every reading has a covariance, so that neither noise floor nor "
                "corrected figures are given, and whether the figures describe the robot or the instrument cannot be "
                "determined.",
                "State the instrument's covariance with each reading.",
            )
        )
    return warnings


def _named(pose_ids: set[str], of: Sequence[str]) -> str:
    if len(pose_ids) == len(of) > 1:
        return f"All {len(of)} poses"
    return f"{'Pose' if len(pose_ids) == 1 else 'Poses'} {listed(p for p in of if p in pose_ids)}"
