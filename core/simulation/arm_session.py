"""A session from which an arm is identified, with its truth: sweeps of every joint before two grids, and free poses.

As in Boby and Saha's experiment two mutually perpendicular grids are taken in turn. One joint at a time is moved
as far as a grid stays in the image. Joints 1 and 2 are swept before either grid from the same place of joint 1: two
axes known in both grids' frames determine the transform between the grids, before any chain is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.geometry import Camera, invert
from core.simulation.arm import KR5_ARC_HOME, KR5_ARC_LIMITS, Arm
from core.simulation.looking import largest_visible_sweep, sample_viewing_configurations
from core.simulation.paper_experiment import JOINT_REPEATABILITY_RAD, SessionImage, workshop_scene
from core.targets import TargetSpec

_DRAWN = 300  # poses before each grid, through which sweeps are tried
_FAR, _NEAR = (0.15, 0.25), (0.3, 0.6)  # share of the image that a grid takes: in sweeps, in free poses


@dataclass(frozen=True, slots=True)
class ArmPose:
    """One pose: the commanded joint angles (rad), and which grid the camera then sees, by its index."""

    pose_id: str
    joint_angles: Float[np.ndarray, " j"]
    target: int


@dataclass(frozen=True, slots=True)
class ArmSession:
    """Poses, and the image taken at each."""

    arm: Arm
    poses: tuple[ArmPose, ...]
    images: tuple[SessionImage, ...]


def simulate_arm_session(
    arm: Arm,
    grid: TargetSpec,
    camera: Camera,
    size_px: tuple[int, int],
    *,
    steps: int,
    free: int,
    seed: int = 0,
) -> ArmSession:
    """Return the session of a KR5 Arc whose targets are all such grids: `steps` poses a sweep, `free` poses a grid.

    Raises ValueError where the arm can hardly look at a target.
    """
    rng = np.random.default_rng([seed, 20160518])
    poses: list[ArmPose] = []
    for target in range(len(arm.T_target_base)):
        letter = chr(ord("A") + target)
        tried, looking = (
            sample_viewing_configurations(
                arm,
                grid,
                camera,
                size_px,
                rng,
                count,
                home=KR5_ARC_HOME,
                limits=KR5_ARC_LIMITS,
                target=target,
                fill=fill,
            )
            for count, fill in ((_DRAWN, _FAR), (free, _NEAR))
        )
        for joint in range(len(arm.chain)):
            through = tried.copy()
            if joint == 1:
                through[:, 0] = KR5_ARC_HOME[0]
            swept = largest_visible_sweep(
                arm, grid, camera, size_px, through, joint, limits=KR5_ARC_LIMITS, steps=steps, target=target
            )
            poses += [ArmPose(f"{letter}-J{joint + 1}-{k + 1}", q, target) for k, q in enumerate(swept)]
        poses += [ArmPose(f"{letter}-free-{k + 1}", q, target) for k, q in enumerate(looking)]
    images = []
    for pose in poses:
        attained = pose.joint_angles + rng.normal(0.0, JOINT_REPEATABILITY_RAD, len(pose.joint_angles))
        commanded, true = arm.camera_poses(np.stack([pose.joint_angles, attained]), np.full(2, pose.target))
        scene = workshop_scene(
            grid,
            camera,
            invert(true),
            size_px,
            seed=int(rng.integers(2**31)),
            background_seed=seed * 1000 + pose.target,
        )
        images.append(SessionImage(pose.pose_id, 1, commanded, scene))
    return ArmSession(arm, tuple(poses), tuple(images))
