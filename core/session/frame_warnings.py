"""The warning of frames whose roll, pitch and yaw are near their singularity."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from core.errors import Advisory
from core.geometry import GIMBAL_MARGIN, is_near_gimbal_lock, rotation_to_rpy
from core.session.model import CameraMount

_NAMES: dict[CameraMount, tuple[str, str]] = {
    "robot": ("T_flange_camera", "T_base_target"),
    "fixed": ("T_flange_target", "T_base_camera"),
}


def gimbal_warnings(
    T_flange_camera: Float[np.ndarray, "4 4"],
    T_base_targets: Sequence[Float[np.ndarray, "4 4"]],
    mount: CameraMount = "robot",
) -> tuple[Advisory, ...]:
    """Warn of the frames, as an answer has them, whose pitch is within `GIMBAL_MARGIN` of ±90°.

    With the camera fixed they are T_flange_target and T_base_camera.
    """
    on_flange, in_base = _NAMES[mount]
    several = len(T_base_targets) > 1
    frames = [(on_flange, T_flange_camera)]
    frames += [(f"{in_base} {k}" if several else in_base, T) for k, T in enumerate(T_base_targets, 1)]
    near = [
        f"{name} ({math.degrees(pitch):.2f}°)"
        for name, T in frames
        if is_near_gimbal_lock(pitch := float(rotation_to_rpy(T[:3, :3])[1]))
    ]
    if not near:
        return ()
    return (
        Advisory(
            "near_gimbal_lock",
            f"Pitch is within {math.degrees(GIMBAL_MARGIN):g}° of ±90° in {' and '.join(near)}, where roll and "
            "yaw cannot be separated: their uncertainties are magnified.",
            "Use the rotation matrix and its covariance instead.",
        ),
    )
