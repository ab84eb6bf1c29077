"""A robot cell for whole runs of the service: a KUKA KR5 with a camera on its flange, before a chessboard."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from core.geometry import Camera, invert, rotation_to_rpy
from core.kinematics import forward
from core.simulation import (
    KR5_ARC,
    KR5_ARC_HOME,
    KR5_ARC_LIMITS,
    kr5_arc,
    sample_viewing_configurations,
)
from core.simulation.paper_experiment import JOINT_REPEATABILITY_RAD, workshop_scene
from core.targets import TargetSpec
from tests.support.image.images import encode
from tests.support.simulation.renders import render

GRID = TargetSpec("chessboard", 9, 6, 30.0)
CAMERA = Camera(650.0, 650.0, 305.0, 250.0, k1=-0.1, k2=0.05)
SIZE_PX = (612, 512)
TARGET = {
    "name": "Glass board 9 x 6",
    "kind": GRID.kind,
    "columns": GRID.columns,
    "rows": GRID.rows,
    "pitch_mm": GRID.pitch_mm,
    "pitch_standard_uncertainty_mm": 0.001,
}


@dataclass(frozen=True)
class CellImage:
    """One image: where it was taken, its file, what the robot was commanded (degrees, mm), and where it was."""

    pose_id: str
    cycle: int
    data: bytes
    commanded: dict[str, Any]
    T_target_camera: Float[np.ndarray, "4 4"]

    @property
    def filename(self) -> str:
        return f"{self.pose_id}-c{self.cycle}.png"

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.data).hexdigest()


def take_images(
    poses: int,
    *,
    repeated: int,
    cycles: int,
    joint_repeatability_rad: float = JOINT_REPEATABILITY_RAD,
) -> list[CellImage]:
    """Return the images of so many poses, P1 first: `cycles` of the first `repeated` ones, one of the others."""
    rng = np.random.default_rng(14)
    arm = kr5_arc(rng)
    angles = sample_viewing_configurations(
        arm, GRID, CAMERA, SIZE_PX, rng, poses, home=KR5_ARC_HOME, limits=KR5_ARC_LIMITS
    )
    images = []
    for index, q in enumerate(angles):
        T_base_flange = forward(KR5_ARC, q[None])[0]
        roll, pitch, yaw = np.degrees(rotation_to_rpy(T_base_flange[:3, :3])).round(6).tolist()
        commanded = {
            "position_mm": T_base_flange[:3, 3].round(6).tolist(),
            **{"roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw},
            "joint_angles_deg": np.degrees(q).round(6).tolist(),
        }
        for cycle in range(1, (cycles if index < repeated else 1) + 1):
            attained = q + rng.normal(0.0, joint_repeatability_rad, len(q))
            T_target_camera = arm.camera_poses(attained[None])[0]
            scene = workshop_scene(
                GRID, CAMERA, invert(T_target_camera), SIZE_PX, seed=100 * index + cycle, background_seed=1
            )
            data = encode(".png", render(scene))
            images.append(CellImage(f"P{index + 1}", cycle, data, commanded, T_target_camera))
    return images
