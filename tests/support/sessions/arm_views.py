"""A session of an arm that grows image by image: what is observed at joint angles, without a renderer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.geometry import invert, so3_exp, transform
from core.kinematics import forward
from core.session import CommandedPose, ImageObservation, SessionData, group_views
from core.simulation import KR5_ARC, KR5_ARC_HOME, KR5_ARC_LIMITS, Arm, kr5_arc, sample_viewing_configurations
from core.targets import GridPoints
from tests.support.sessions.stored_sessions import BOARD, CAMERA, HEIGHT, WIDTH, commanded_pose, look

NOISE_PX = 0.05
SCATTER_MM, SCATTER_RAD = 0.05, math.radians(0.004)


@dataclass
class ArmViews:
    """Images that an arm takes of one board, and what was commanded of them.

    `commanded_mm` and `commanded_rad` are the standard deviations, along each axis, of what the arm attains from what
    it was commanded.
    """

    arm: Arm
    rng: np.random.Generator
    commanded_mm: float = 0.0
    commanded_rad: float = 0.0

    def __post_init__(self) -> None:
        self.joint_angles = np.zeros((0, len(self.arm.chain)))
        self._points: list[GridPoints] = []
        self._commanded: list[CommandedPose] = []

    def take(self, joint_angles: Float[np.ndarray, "n j"]) -> None:
        """Take an image at each of some joint angles (rad)."""
        rng = self.rng
        for q, flange in zip(joint_angles, forward(self.arm.chain, joint_angles), strict=True):
            off = transform(
                so3_exp(rng.normal(0.0, self.commanded_rad, 3)) @ flange[:3, :3],
                flange[:3, 3] + rng.normal(0.0, self.commanded_mm, 3),
            )
            angles = np.degrees(q).tolist()
            self._commanded.append(CommandedPose(**commanded_pose(off), joint_angles_deg=angles))
            T = self.arm.T_target_base[0] @ flange @ self.arm.T_flange_camera
            T = transform(
                so3_exp(rng.normal(0.0, SCATTER_RAD, 3)) @ T[:3, :3],
                T[:3, 3] + rng.normal(0.0, SCATTER_MM, 3),
            )
            self._points.append(look(rng, invert(T), sigma_px=NOISE_PX))
        self.joint_angles = np.concatenate([self.joint_angles, joint_angles])

    def keep(self, count: int) -> None:
        """Forget all images but the first."""
        self.joint_angles = self.joint_angles[:count]
        del self._points[count:], self._commanded[count:]

    def all(self) -> SessionData:
        """Return the session of all images."""
        names = [f"P{i + 1}" for i in range(len(self._points))]
        images = tuple(
            ImageObservation(f"m{i}", name, 1, f"i{i}", 0, "default", None, WIDTH, HEIGHT)
            for i, name in enumerate(names)
        )
        return SessionData(
            (BOARD,),
            ("a",),
            images,
            group_views(images, dict(enumerate(self._points))),
            dict(zip(names, self._commanded, strict=True)),
            nominal=KR5_ARC,
        )


def arm_before_board(rng: np.random.Generator, *, as_built: bool) -> Arm:
    """Return a KR5 Arc before one board; `as_built`: every length and angle is a little off its data sheet."""
    scale = 1.0 if as_built else 0.0
    arm = kr5_arc(rng, deviation_mm=0.3 * scale, deviation_rad=math.radians(0.03) * scale)
    return Arm(arm.chain, arm.T_target_base[:1], arm.T_flange_camera)


def viewing_angles(
    arm: Arm, rng: np.random.Generator, count: int, limits: Float[np.ndarray, "j 2"] = KR5_ARC_LIMITS
) -> Float[np.ndarray, "n j"]:
    """Draw joint angles (rad) at each of which the camera sees the board, as steep, near and far as plans may."""
    return sample_viewing_configurations(
        arm,
        BOARD,
        CAMERA,
        (WIDTH, HEIGHT),
        rng,
        count,
        home=KR5_ARC_HOME,
        limits=limits,
        tilt=math.radians(50.0),
        fill=(0.35, 0.9),
    )
