"""Boby and Saha's experiment with its truth: a KUKA KR5 Arc with a camera on its flange visits five poses of a cube.

ISO 9283:1998, 6.8: P1 is the centre of the cube, P2 to P5 lie on the diagonals of its measuring plane, 10 % of their
length from the ends. The camera looks at the middle of a board on the table; the robot's joints return to their
commanded angles with a small error, so that each pose scatters by a covariance of its own, which is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.errors import InvalidArgument
from core.geometry import (
    Camera,
    compose,
    invert,
    rotation_to_rpy,
    rpy_jacobian,
    so3_exp,
    transform,
    transform_points,
)
from core.metrology import PerComponent, eigenvalues, long_run_rp
from core.simulation.arm import (
    KR5_ARC,
    KR5_ARC_HOME,
    KR5_ARC_LIMITS,
    T_FLANGE_CAMERA,
    Arm,
    joint_motions,
    kr5_arc,
    reach,
)
from core.simulation.scenes import Light, Scene
from core.targets import TargetSpec

CUBE_MM = 100.0
FROM_THE_END = 0.1
JOINT_REPEATABILITY_RAD = 33e-6
"""Standard deviation of each joint about its commanded angle; makes some 0.1 mm of RP_l, as the maker claims."""
_SPAN = 0.5  # share of the image that the board takes
_STEPS = 100
_WITHIN_MM = 1e-9
_CONTROLLER = Arm(KR5_ARC, np.eye(4)[None], np.eye(4))
"""The robot as its controller has it: what it reaches for is T_base_flange."""


@dataclass(frozen=True, slots=True)
class CubePose:
    """One pose: the command, and how the camera truly scatters about its mean.

    `covariance` is of x, y, z (mm), then a small rotation (rad) from the left, in the target frame.
    """

    pose_id: str
    joint_angles: Float[np.ndarray, "6"]
    commanded_T_base_flange: Float[np.ndarray, "4 4"]
    mean_T_target_camera: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]

    @property
    def true_repeatability(self) -> PerComponent[float]:
        """RP_l and 3 S after endless cycles, mm and rad; angles by rotation vectors mapped to roll, pitch, yaw."""
        reading = float(long_run_rp(eigenvalues(self.covariance[:3, :3])))
        J = np.eye(6)
        J[3:, 3:] = rpy_jacobian(rotation_to_rpy(self.mean_T_target_camera[:3, :3]))
        spread = 3.0 * np.sqrt(np.diag(J @ self.covariance @ J.T))
        return PerComponent(reading, *spread.tolist())


@dataclass(frozen=True, slots=True)
class Experiment:
    """The arm as built, the poses, and the images in the order they are taken: pose by pose within each cycle."""

    arm: Arm
    poses: tuple[CubePose, ...]
    images: tuple[SessionImage, ...]


def cube_experiment(
    target: TargetSpec,
    camera: Camera,
    size_px: tuple[int, int],
    *,
    cycles: int,
    seed: int = 0,
) -> Experiment:
    """Return the experiment before a board; arm, mount, view and scatter are drawn by the seed.

    The arm as built differs from its data sheet by tenths of a millimetre and the camera's mount by millimetres, so
    that no pose is exactly the commanded one.

    Raises InvalidArgument where the arm does not reach.
    """
    rng = np.random.default_rng([seed, 20160517])
    arm = kr5_arc(rng)
    T_base_target = invert(arm.T_target_base[0])
    views = _views(target, camera, size_px, T_base_target, rng)
    poses = tuple(
        _pose(f"P{i + 1}", T_base_camera, arm, JOINT_REPEATABILITY_RAD)
        for i, T_base_camera in enumerate(views)
    )
    images = []
    for cycle in range(1, cycles + 1):
        for index, pose in enumerate(poses):
            angles = pose.joint_angles + rng.normal(0.0, JOINT_REPEATABILITY_RAD, 6)
            scene = workshop_scene(
                target,
                camera,
                invert(arm.camera_poses(angles[None])[0]),
                size_px,
                seed=int(rng.integers(2**31)),
                background_seed=seed * 1000 + index,
            )
            commanded = compose(arm.T_target_base[0], pose.commanded_T_base_flange, T_FLANGE_CAMERA)
            images.append(SessionImage(pose.pose_id, cycle, commanded, scene))
    return Experiment(arm, poses, tuple(images))


def cube_points(centre_mm: Float[np.ndarray, "3"]) -> Float[np.ndarray, "5 3"]:
    """Return P1 to P5 of a cube along the axes: its centre, and 10 % from the ends of the measuring plane's diagonals.

    The measuring plane holds y and the diagonal of x and z.
    """
    half = (0.5 - FROM_THE_END) * CUBE_MM
    corners = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [-1.0, -1.0, -1.0], [-1.0, 1.0, -1.0]])
    return centre_mm + np.vstack([np.zeros((1, 3)), half * corners])


def _views(
    target: TargetSpec,
    camera: Camera,
    size_px: tuple[int, int],
    T_base_target: Float[np.ndarray, "4 4"],
    rng: np.random.Generator,
) -> list[Float[np.ndarray, "4 4"]]:
    """Return T_base_camera of the five poses: each looks at the board's middle, at about 30° to its normal."""
    middle = np.array([target.columns - 1, target.rows - 1, 0.0]) * target.pitch_mm / 2.0
    extent = np.array([target.columns + 1, target.rows + 1]) * target.pitch_mm
    distance = float(np.max(extent * np.array([camera.fx_px, camera.fy_px]) / (_SPAN * np.array(size_px))))
    tilt, side, roll = np.radians(rng.uniform([28.0, 40.0, -15.0], [32.0, 70.0, 15.0]))
    axis = np.array([-math.sin(side), math.cos(side), 0.0])
    ahead = so3_exp(tilt * axis) @ np.array([0.0, 0.0, 1.0])
    centre, at = transform_points(T_base_target, np.stack([middle - distance * ahead, middle]))
    upright = T_base_target[:3, :3] @ so3_exp(tilt * axis) @ so3_exp(np.array([0.0, 0.0, roll]))
    views = []
    for place in cube_points(centre):
        now, wanted = upright[:, 2], (at - place) / np.linalg.norm(at - place)
        turn = np.cross(now, wanted)
        sine = float(np.linalg.norm(turn))
        angle = math.atan2(sine, float(now @ wanted))
        views.append(transform(so3_exp(turn * (angle / sine if sine > 0.0 else 0.0)) @ upright, place))
    return views


def _pose(
    pose_id: str, T_base_camera: Float[np.ndarray, "4 4"], arm: Arm, joint_repeatability_rad: float
) -> CubePose:
    T_base_flange = compose(T_base_camera, invert(T_FLANGE_CAMERA))
    angles = reach(_CONTROLLER, T_base_flange, KR5_ARC_HOME, steps=_STEPS, within_mm=_WITHIN_MM)
    if angles is None:
        raise InvalidArgument(
            f"{pose_id} is out of the arm's reach.", "Choose a smaller grid, or a wider lens."
        )
    if np.any(angles < KR5_ARC_LIMITS[:, 0]) or np.any(angles > KR5_ARC_LIMITS[:, 1]):
        raise InvalidArgument(f"{pose_id} lies beyond the limits of a joint.")
    mean, J = joint_motions(arm, angles)
    return CubePose(pose_id, angles, T_base_flange, mean, joint_repeatability_rad**2 * (J @ J.T))


@dataclass(frozen=True, slots=True)
class SessionImage:
    """One image a robot session would send: its tags, the commanded pose, and the scene with the truth.

    `commanded_T_target_camera` is the same for all cycles of a pose; `scene.T_camera_target` is what came of
    it.
    """

    pose_id: str
    cycle: int
    commanded_T_target_camera: Float[np.ndarray, "4 4"]
    scene: Scene

    @property
    def true_T_target_camera(self) -> Float[np.ndarray, "4 4"]:
        """Where the camera really was."""
        return invert(self.scene.T_camera_target)


def workshop_scene(
    target: TargetSpec,
    camera: Camera,
    T_camera_target: Float[np.ndarray, "4 4"],
    size_px: tuple[int, int],
    *,
    seed: int,
    background_seed: int,
) -> Scene:
    """Return a scene as robot sessions have it: a good lens and sensor, uneven light, things behind the board."""
    return Scene(
        target=target,
        camera=camera,
        T_camera_target=T_camera_target,
        width_px=size_px[0],
        height_px=size_px[1],
        noise_levels=2.0,
        light=Light(gradient=(0.1, -0.08), vignetting=0.15),
        clutter=0.7,
        seed=seed,
        background_seed=background_seed,
    )
