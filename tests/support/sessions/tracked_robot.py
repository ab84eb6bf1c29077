"""A robot before another instrument: poses that it is drawn_poses, and what the instrument reads of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from core.geometry.roll_pitch_yaw import rotation_to_rpy
from core.geometry.se3 import compose, so3_exp, transform

# the instrument's, known
SIGMA_MM = 0.02


SIGMA_RAD = 2e-5


# the robot's
SCATTER_MM = 0.06


SCATTER_RAD = 8e-5


T_TRACKER_BASE = transform(so3_exp(np.array([0.4, -0.1, 2.0])), np.array([3000.0, -200.0, 150.0]))


T_FLANGE_PROBE = transform(so3_exp(np.array([0.0, 0.3, -0.4])), np.array([40.0, -25.0, 110.0]))


HOME = np.array([900.0, 0.0, 600.0])


COVARIANCE = np.diag([SIGMA_MM**2] * 3 + [SIGMA_RAD**2] * 3)


def drawn_poses(seed: int, poses: int) -> list[Any]:
    """T_base_flange of some poses, spread and turned."""
    rng = np.random.default_rng(seed)
    return [
        transform(so3_exp(rng.uniform(-0.8, 0.8, 3)), rng.uniform(-400.0, 400.0, 3) + HOME)
        for _ in range(poses)
    ]


def readings(
    poses: list[Any], cycles: int = 12, seed: int = 1, *, rotations: bool = True, covariances: bool = True
) -> list[dict[str, Any]]:
    """What a laser tracker reads of a robot that scatters."""
    rng = np.random.default_rng(seed)
    found = []
    for cycle in range(1, cycles + 1):
        for index, T_base_flange in enumerate(poses):
            T = compose(T_TRACKER_BASE, T_base_flange, T_FLANGE_PROBE)
            d = rng.normal(0.0, SCATTER_MM, 3) + rng.normal(0.0, SIGMA_MM, 3)
            w = rng.normal(0.0, SCATTER_RAD, 3) + rng.normal(0.0, SIGMA_RAD, 3)
            found.append(
                {
                    "pose_id": f"P{index + 1}",
                    "cycle": cycle,
                    "position_mm": (T[:3, 3] + d).tolist(),
                    "rotation": (so3_exp(w) @ T[:3, :3]).tolist() if rotations else None,
                    "covariance": COVARIANCE.tolist() if covariances else None,
                }
            )
    return found


def send(api: Any, session: str, sent: list[dict[str, Any]]) -> list[str]:
    response = api.client.post(f"/v1/sessions/{session}/measured-poses", json=sent)
    assert response.status_code == 200, response.text
    return [item["id"] for item in response.json()["items"]]


def send_commands(api: Any, session: str, poses: list[Any], *, oriented: bool = True) -> None:
    commanded = []
    for index, T in enumerate(poses):
        angles = np.degrees(rotation_to_rpy(T[:3, :3])).tolist() if oriented else [None] * 3
        commanded.append(
            {
                "pose_id": f"P{index + 1}",
                "position_mm": T[:3, 3].tolist(),
                **dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), angles, strict=True)),
            }
        )
    assert api.client.post(f"/v1/sessions/{session}/poses", json=commanded).status_code == 200
