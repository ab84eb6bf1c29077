"""Commanded and measured poses of a robot with a camera on its flange, as numbers: what frame tying is tested on.

The frames, the robot's deviations and the camera's noise are known; no image is rendered.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from jaxtyping import Float

from core.calibration.hand_eye import (
    HandEyeCalibration,
    HandEyeObservation,
    PositionObservation,
)
from core.geometry.se3 import perturbed, so3_exp, so3_log, transform

T_FLANGE_CAMERA = transform(so3_exp(np.array([0.1, -0.2, 1.5])), np.array([60.0, -25.0, 90.0]))
T_BASE_TARGET = transform(so3_exp(np.array([3.0, 0.1, 0.2])), np.array([900.0, 150.0, -100.0]))
POINT_CAMERA_MM = np.array([-40.0, 25.0, 120.0])
"""Where the tool's tip is in the camera frame, for robots that are commanded by position."""
MEASURED_COVARIANCE = np.diag([0.06**2, 0.06**2, 0.03**2] + [math.radians(0.002) ** 2] * 3)
# A camera that tilts seems to move: the usual correlation of a pose from a grid.
MEASURED_COVARIANCE[0, 4] = MEASURED_COVARIANCE[4, 0] = 0.8 * 0.06 * math.radians(0.002)
TURNS = {
    "free": np.array([1.0, 1.0, 1.0]),
    "about_z": np.array([0.0, 0.0, 1.0]),
    "none": np.zeros(3),
}
"""Which components of the camera's rotations there are."""


def draw_stations(
    rng: np.random.Generator,
    count: int,
    *,
    turns: str = "free",
    robot_mm: float = 0.3,
    robot_rad: float = math.radians(0.03),
    noise: float = 1.0,
) -> list[HandEyeObservation]:
    """Draw stations whose robot deviates by `robot_mm` and `robot_rad` along each axis.

    `turns` is a key of `TURNS`, `noise` the camera's in units of `MEASURED_COVARIANCE`'s.
    """
    found = []
    for index, T in enumerate(_draw_camera_poses(rng, count, turns)):
        attained = T_BASE_TARGET @ T @ np.linalg.inv(T_FLANGE_CAMERA)
        off = np.concatenate([rng.normal(0.0, robot_mm, 3), rng.normal(0.0, robot_rad, 3)])
        measured = perturbed(T, noise * _draw_noise(rng))
        covariance = noise**2 * MEASURED_COVARIANCE
        found.append(HandEyeObservation(f"P{index + 1}", perturbed(attained, off), measured, covariance))
    return found


def draw_position_stations(
    rng: np.random.Generator, count: int, *, turns: str = "free", robot_mm: float = 0.3
) -> list[PositionObservation]:
    """Draw stations of a robot that is commanded to positions of its tool's tip alone."""
    found = []
    for index, T in enumerate(_draw_camera_poses(rng, count, turns)):
        inside = T[:3, 3] + T[:3, :3] @ POINT_CAMERA_MM
        position = T_BASE_TARGET[:3, :3] @ inside + T_BASE_TARGET[:3, 3] + rng.normal(0.0, robot_mm, 3)
        measured = perturbed(T, _draw_noise(rng))
        found.append(PositionObservation(f"P{index + 1}", position, measured, MEASURED_COVARIANCE))
    return found


def _draw_noise(rng: np.random.Generator) -> Float[np.ndarray, "6"]:
    return np.asarray(np.linalg.cholesky(MEASURED_COVARIANCE) @ rng.normal(0.0, 1.0, 6))


def _draw_camera_poses(rng: np.random.Generator, count: int, turns: str) -> list[Float[np.ndarray, "4 4"]]:
    """Draw T_target_camera some 400 mm before the target, turned by up to 35° as `turns` allows."""
    poses = []
    for _ in range(count):
        w = rng.normal(0.0, 1.0, 3)
        w *= math.radians(35.0) * rng.uniform(0.4, 1.0) / np.linalg.norm(w)
        place = np.array([70.0, 50.0, -400.0]) + rng.normal(0.0, 60.0, 3)
        poses.append(transform(so3_exp(np.array([0.2, 0.1, 0.3])) @ so3_exp(w * TURNS[turns]), place))
    return poses


def errors(tie: HandEyeCalibration) -> np.ndarray:
    """True - estimated, in the order of the covariance."""
    found = []
    for true, T in ((T_FLANGE_CAMERA, tie.T_flange_camera), (T_BASE_TARGET, tie.T_base_targets[0])):
        found += [true[:3, 3] - T[:3, 3], so3_log(true[:3, :3] @ T[:3, :3].T)]
    return np.concatenate(found)


def exact(seed: int, count: int, turns: str = "free") -> list[HandEyeObservation]:
    found = draw_stations(
        np.random.default_rng(seed), count, turns=turns, robot_mm=0.0, robot_rad=0.0, noise=1e-9
    )
    return [dataclasses.replace(s, covariance=None) for s in found]
