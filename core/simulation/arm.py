"""A simulated robot arm with a camera on its flange: the KUKA KR5 Arc, and deviations that its data sheet hides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.geometry import compose, invert, so3_exp, so3_log, transform
from core.kinematics import Chain, forward, pose_with_jacobian

KR5_ARC_ROWS = (
    (180.0, -90.0, 400.0, 0.0),
    (600.0, 0.0, 0.0, -90.0),
    (120.0, 90.0, 0.0, 0.0),
    (0.0, -90.0, -620.0, 0.0),
    (0.0, 90.0, 0.0, 0.0),
    (0.0, 180.0, -115.0, 0.0),
)
"""The nominal geometry, by the maker's data sheet, classic DH: a (mm), α (deg), d (mm), offset of θ (deg)."""
KR5_ARC = Chain.from_rows(KR5_ARC_ROWS)
KR5_ARC_LIMITS = np.radians(
    [[-155.0, 155.0], [-180.0, 65.0], [-15.0, 158.0], [-350.0, 350.0], [-130.0, 130.0], [-350.0, 350.0]]
)
"""Least and largest angle of each joint, rad."""
KR5_ARC_HOME = np.radians([0.0, -65.0, 75.0, 10.0, 55.0, 0.0])
T_FLANGE_CAMERA = transform(so3_exp(np.array([0.05, -0.08, 0.4])), np.array([65.0, -30.0, 80.0]))
_PARALLEL = 1e-6  # sine of a nominal twist below which neighbours are meant to be parallel
_LEVER_MM = 500.0  # a rotation counts as what it moves at this distance
_LARGEST_STEP = 0.3  # rad
_MOUNT_MM, _MOUNT_RAD = 3.0, math.radians(1.0)  # standard deviations of the camera's mount


@dataclass(frozen=True, slots=True)
class Arm:
    """A chain that holds a camera before one or more targets, all exactly known."""

    chain: Chain
    T_target_base: Float[np.ndarray, "t 4 4"]
    T_flange_camera: Float[np.ndarray, "4 4"]

    def camera_poses(
        self, joint_angles: Float[np.ndarray, "n j"], target: Int[np.ndarray, " n"] | None = None
    ) -> Float[np.ndarray, "n 4 4"]:
        """Return T_target_camera at joint angles in rad, of the target of each index."""
        which = np.zeros(len(joint_angles), dtype=np.intp) if target is None else target
        return np.asarray(
            self.T_target_base[which] @ forward(self.chain, joint_angles) @ self.T_flange_camera
        )


def joint_motions(
    arm: Arm, angles: Float[np.ndarray, " j"], target: int = 0
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "6 j"]]:
    """Return T_target_camera at joint angles in rad, and how each joint moves it.

    A column has mm/rad along the target's axes, then rad/rad of the rotation from the left.
    """
    end, J = pose_with_jacobian(
        arm.chain.as_array(), angles[None], arm.T_target_base[target][None], arm.T_flange_camera
    )
    return end[0], J[3 : 5 * len(angles) : 5, :, 0].T  # a joint's turn is its offset's


def reach(
    arm: Arm,
    T_target_camera: Float[np.ndarray, "4 4"],
    start: Float[np.ndarray, " j"],
    target: int = 0,
    *,
    steps: int = 20,
    within_mm: float = 1e-6,
) -> Float[np.ndarray, " j"] | None:
    """Return joint angles (rad) that bring the camera there, by damped Newton steps from a start; None where none are
    found. Limits of joints are not looked at.
    """
    angles = start
    weight = np.repeat([1.0, _LEVER_MM], 3)
    for _ in range(steps):
        end, motions = joint_motions(arm, angles, target)
        turn = so3_log(compose(T_target_camera, invert(end))[:3, :3])
        error = weight * np.concatenate([T_target_camera[:3, 3] - end[:3, 3], turn])
        if float(np.linalg.norm(error)) < within_mm:
            return angles
        columns = motions * weight[:, None]
        H = columns.T @ columns
        step = np.linalg.solve(H + 1e-6 * np.trace(H) * np.eye(len(H)), columns.T @ error)
        angles = angles + np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
    return None


def kr5_arc(
    rng: np.random.Generator,
    *,
    deviation_mm: float = 0.3,
    deviation_rad: float = math.radians(0.03),
) -> Arm:
    """Draw a KR5 Arc as built: every length and angle is off by a little, and the camera's mount by more.

    Standard deviations are given. There are two targets, mutually perpendicular: one lies nearly flat, its face up,
    the other stands ahead of the robot and faces it.
    """
    flat = so3_exp(np.array([math.pi, 0.0, 0.3]))
    upright = flat @ so3_exp(np.array([0.0, math.pi / 2.0, 0.0])) @ so3_exp(np.array([0.0, 0.0, 0.2]))
    T_base_target = [
        transform(flat, np.array([900.0, -150.0, 250.0])),
        transform(upright, np.array([1350.0, 100.0, 700.0])),
    ]
    return Arm(
        deviated(KR5_ARC, rng, deviation_mm, deviation_rad),
        np.linalg.inv(np.array(T_base_target)),
        T_FLANGE_CAMERA @ transform(so3_exp(rng.normal(0.0, _MOUNT_RAD, 3)), rng.normal(0.0, _MOUNT_MM, 3)),
    )


def deviated(chain: Chain, rng: np.random.Generator, deviation_mm: float, deviation_rad: float) -> Chain:
    """Return the chain, every parameter off by a normal deviation; β only between neighbours meant to be parallel."""
    nominal = chain.as_array()
    scale = np.array([deviation_mm, deviation_rad, deviation_mm, deviation_rad, deviation_rad])
    off = rng.normal(0.0, 1.0, nominal.shape) * scale
    off[np.abs(np.sin(nominal[:, 1])) > _PARALLEL, 4] = 0.0
    off[-1, 4] = 0.0  # the last link has no neighbour
    return Chain.from_array(nominal + off)


def sweep_angles(
    home: Float[np.ndarray, " j"],
    *,
    half_arc: float = math.radians(40.0),
    steps: int = 11,
    joints: Sequence[int] | None = None,
) -> Float[np.ndarray, "n j"]:
    """Return joint angles (rad) of one sweep per joint about a home, `steps` poses each, joint after joint."""
    moves = np.linspace(-half_arc, half_arc, steps)
    swept = range(len(home)) if joints is None else joints
    return np.concatenate([home + moves[:, None] * np.eye(len(home))[joint] for joint in swept])


def free_angles(
    rng: np.random.Generator,
    home: Float[np.ndarray, " j"],
    count: int,
    *,
    half_range: float = math.radians(40.0),
) -> Float[np.ndarray, "n j"]:
    """Draw joint angles (rad) at random about a home, all joints at once."""
    return np.asarray(home + rng.uniform(-half_range, half_range, (count, len(home))))
