"""A robot that misses its commands by more in later cycles, measured in frames of the target and the camera."""

from __future__ import annotations

import numpy as np

from core.geometry import rpy_to_rotation, so3_exp, transform
from core.session import CommandedPose, MeasuredPose, SessionData

PLACES = 200.0 * np.array(
    [[0, 0, 0], [1, 1, 1], [-1, -1, 1], [1, -1, -1], [-1, 1, -1], [0, 1, 0]], dtype=np.float64
)
BASE = transform(so3_exp(np.array([0.4, -0.3, 1.1])), np.array([500.0, 20.0, 300.0]))
CAMERA = transform(so3_exp(np.array([0.1, 0.2, -0.4])), np.array([30.0, -60.0, 110.0]))
SIX = [f"P{i + 1}" for i in range(6)]


def drifting_session(
    turns: np.ndarray, off_mm: np.ndarray, drift_mm: np.ndarray, drift_rad: np.ndarray, noise_mm: np.ndarray
) -> tuple[SessionData, dict[str, list[MeasuredPose]]]:
    """Six poses of 20 cycles: in the second ten each flange is off by its drift as well, in the base frame."""
    commanded, visits = {}, {}
    for i, name in enumerate(SIX):
        commanded[name] = CommandedPose(PLACES[i].tolist(), *np.degrees(turns[i]).tolist())
        visits[name] = []
        for k in range(20):
            late = float(k >= 10)
            attained = transform(
                so3_exp(late * drift_rad[i]) @ rpy_to_rotation(turns[i]),
                PLACES[i] + off_mm[i] + late * drift_mm[i] + noise_mm[i, k],
            )
            T = np.linalg.inv(BASE) @ attained @ CAMERA
            visits[name].append(
                MeasuredPose(f"{name}-{k}", name, k + 1, None, T[:3, 3], T[:3, :3], None, None)
            )
    return SessionData((), (), commanded=commanded), visits
