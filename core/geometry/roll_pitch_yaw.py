"""Rotations as roll, pitch and yaw: R = Rz(yaw) Ry(pitch) Rx(roll), singular at pitch = ±90°. Angles in radians."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

GIMBAL_MARGIN = math.radians(5.0)
"""Within this angle of pitch = ±90°, roll and yaw are reported with a warning."""


def is_near_gimbal_lock(pitch: float) -> bool:
    """Return whether a pitch angle is within `GIMBAL_MARGIN` of ±90°, where roll and yaw cannot be separated."""
    return abs(abs(pitch) - 0.5 * math.pi) < GIMBAL_MARGIN


def rpy_to_rotation(roll_pitch_yaw: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = (float(a) for a in roll_pitch_yaw)
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_to_rpy(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3"]:
    """Return roll and yaw in (-π, π], pitch in [-π/2, π/2]; at the singularity yaw carries all and roll is 0.

    Their product equals R to 1e-12 also near the singularity: roll is that of Rz(-yaw) R, which compensates the
    rounding error of yaw.
    """
    r = rotation
    cos_pitch = math.hypot(r[0, 0], r[1, 0])
    pitch = math.atan2(-r[2, 0], cos_pitch)
    if cos_pitch < 1e-12:
        return np.array([0.0, pitch, math.atan2(-r[0, 1], r[1, 1])])
    yaw = math.atan2(r[1, 0], r[0, 0])
    c, s = math.cos(yaw), math.sin(yaw)
    roll = math.atan2(s * r[0, 2] - c * r[1, 2], c * r[1, 1] - s * r[0, 1])
    return np.array([roll, pitch, yaw])


def rpy_jacobian(roll_pitch_yaw: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return d(roll, pitch, yaw)/dw for R_true = exp(w) R.

    w = E(pitch, yaw) (roll', pitch', yaw')ᵀ with columns Rz Ry x, Rz y, z; its inverse grows as 1/cos(pitch).
    Within 1e-6 rad of the singularity it is evaluated at that distance, where the uncertainty is as good as
    unbounded.
    """
    _, pitch, yaw = (float(a) for a in roll_pitch_yaw)
    cp = math.cos(pitch)
    cp = math.copysign(max(abs(cp), 1e-6), cp)
    tp = math.sin(pitch) / cp
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array([[cy / cp, sy / cp, 0.0], [-sy, cy, 0.0], [cy * tp, sy * tp, 1.0]])
