"""Repeated poses of a KR5 whose joints stop with errors of known size."""

from __future__ import annotations

import math

import numpy as np

from core.geometry import rotations_from_vectors
from core.kinematics import Chain, PoseData, forward
from core.simulation.arm import KR5_ARC_HOME, Arm, kr5_arc

JOINT_SIGMA = np.radians([0.004, 0.006, 0.005, 0.003, 0.008, 0.010])


def repeated_poses(
    seed: int,
    *,
    poses: int = 12,
    visits: int = 30,
    joint_sigma: np.ndarray = JOINT_SIGMA,
    instrument: tuple[float, float] = (0.01, 5e-5),
    remaining_mm: float = 0.0,
    half_range: float = math.radians(50.0),
    stated: bool = True,
    rotations: bool = True,
) -> tuple[Arm, PoseData, np.ndarray]:
    """An arm, what an instrument reads of its repeated poses, and the joint angles commanded (rad, one row a pose)."""
    rng = np.random.default_rng(seed)
    arm = kr5_arc(rng)
    q = KR5_ARC_HOME + rng.uniform(-half_range, half_range, (poses, 6))
    commanded = np.repeat(q, visits, axis=0)
    T = camera_poses(arm, commanded + rng.normal(size=commanded.shape) * joint_sigma)
    noise = rng.normal(size=(len(T), 6)) * np.repeat(instrument, 3)
    noise[:, :3] += rng.normal(size=(len(T), 3)) * remaining_mm
    covariance = np.diag(np.repeat(np.square(instrument), 3))
    data = PoseData(
        commanded,
        T[:, :3, 3] + noise[:, :3],
        rotations_from_vectors(noise[:, 3:]) @ T[:, :3, :3] if rotations else None,
        np.broadcast_to(covariance, (len(T), 6, 6)) if stated else None,
        labels=tuple(f"P{i}" for i in np.repeat(np.arange(poses), visits)),
    )
    return arm, data, q


def camera_poses(arm: Arm, q: np.ndarray) -> np.ndarray:
    """T_target_camera at joint angles (rad)."""
    chain: Chain = arm.chain
    return np.asarray(arm.T_target_base[0] @ forward(chain, q) @ arm.T_flange_camera)
