"""The camera on the robot and the target fixed, or the camera fixed and the target on the robot's flange.

The pose of an image is T_target_camera. Of it, one frame stands still in the cell and the other one moves with the
flange:

    camera on the robot   T_base_flange = T_base_target @ T_target_camera @ T_camera_flange
    camera fixed          T_base_flange = T_base_camera @ T_camera_target @ T_target_flange

Both have one form with T_fixed_moving, the moving frame in the fixed one, which is what figures of the robot are of:
the scatter of T_target_camera of a fixed camera would be that of the robot's base as the flange sees it, with every
turn of the flange multiplied by the distance between camera and target.

R_true = exp(w) R and p_true = p + d of a pose give w' = -Rᵀ w and d' = -Rᵀ d - Rᵀ [p]× w of its inverse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from core.errors import SeveralTargetsOnFlange
from core.geometry import hats
from core.session.model import MeasuredPose, SessionData


def moving_poses(data: SessionData, poses: Sequence[MeasuredPose]) -> tuple[MeasuredPose, ...]:
    """Return poses of images (T_target_camera) as what moves with the flange in what stands still: T_target_camera, of
    a fixed camera T_camera_target. Poses of another instrument are that already.
    """
    if data.camera_mount == "robot":
        return tuple(poses)
    return tuple(pose if pose.image is None else _inverse(pose) for pose in poses)


def check_one_on_flange(data: SessionData, poses: Sequence[MeasuredPose]) -> None:
    """Raise SeveralTargetsOnFlange where a fixed camera saw several targets, as they may lie anyhow to one another."""
    if data.camera_mount == "fixed":
        seen = sorted({pose.frame for pose in poses if pose.image is not None})
        if len(seen) > 1:
            raise SeveralTargetsOnFlange(
                f"The camera is fixed, and {len(seen)} targets were seen on the flange: "
                f"{', '.join(data.target_ids[k] for k in seen)}."
            )


def inverse_effects(
    position_mm: Float[np.ndarray, "n 3"], rotations: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n 6 6"]:
    """Return what small motions (d, w) of poses do to their inverses."""
    back = rotations.swapaxes(1, 2)
    J = np.zeros((len(rotations), 6, 6))
    J[:, :3, :3] = J[:, 3:, 3:] = -back
    J[:, :3, 3:] = -back @ hats(position_mm)
    return J


def inverse_covariance(
    covariance: Float[np.ndarray, "n 6 6"], effects: Float[np.ndarray, "n 6 6"]
) -> Float[np.ndarray, "n 6 6"]:
    """Return covariances of the inverses, symmetric to the last digit."""
    found = effects @ covariance @ effects.swapaxes(1, 2)
    return np.asarray(0.5 * (found + found.swapaxes(1, 2)))


def _inverse(pose: MeasuredPose) -> MeasuredPose:
    assert pose.rotation is not None  # poses of images have one
    J = inverse_effects(pose.position_mm[None], pose.rotation[None])

    def of(covariance: Float[np.ndarray, "6 6"] | None) -> Float[np.ndarray, "6 6"] | None:
        return None if covariance is None else inverse_covariance(covariance[None], J)[0]

    back = pose.rotation.T
    return replace(
        pose,
        position_mm=-back @ pose.position_mm,
        rotation=np.ascontiguousarray(back),
        covariance=of(pose.covariance),
        scatter=of(pose.scatter),
        common=None if pose.common is None else J[0] @ pose.common,
        burst=tuple(_inverse(one) for one in pose.burst),
    )
