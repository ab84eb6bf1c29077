"""Planning of poses: predicted uncertainties before the robot is moved, and the poses that would reduce them most.

`predict` linearises the images that a camera would take at given joint angles: their grid points, with the noise that a
detector has, give the covariance of every pose and of the lens; with the robot's own scatter these give the covariance
of every parameter, as `identification` will state it. `suggest` chooses from candidates, one after another, the pose
that raises Borm and Menq's observability index most: of all singular values' geometric mean, to which a pose with
Jacobian J adds log det(1 + J M⁻¹ Jᵀ) over twice their number, M being the information of the poses so far.

References: J.-H. Borm, C.-H. Menq, Int. J. Robotics Research 10 (1991) 584-597; Y. Sun, J. M. Hollerbach, ICRA 2008
(active calibration).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration import Lens, Placements, stack_views
from core.errors import TooFewPoses
from core.geometry import Camera, invert, project, transform, transform_points
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import Chain, forward
from core.kinematics.global_fit import (
    DEFAULT_SCATTER,
    Conditioning,
    ImageObservations,
    Observations,
    Unidentifiable,
    conditioning,
    fix_gauge,
    information_of,
    linearise_images,
    linearised,
    observations_of,
    scaled,
)
from core.kinematics.results import JointEstimate, joint_estimates
from core.numerics import SMALLEST, Variances, covariance_of
from core.targets import GridPoints, TargetSpec

LARGEST_TILT = math.radians(65.0)  # beyond it grids are hardly detected


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """Camera and grids: where they are, and how well grid points are located.

    `T_target_base` is one for each of `targets`; `noise_px` the standard deviation of a grid point's coordinate;
    `scatter_position_mm` and `scatter_rotation` (rad) the robot's own, of each coordinate of the camera's pose.
    """

    camera: Camera
    width_px: int
    height_px: int
    noise_px: float
    targets: tuple[TargetSpec, ...]
    T_flange_camera: Float[np.ndarray, "4 4"]
    T_target_base: Float[np.ndarray, "t 4 4"]
    scatter_position_mm: float = 0.0
    scatter_rotation: float = 0.0
    lens: Lens | None = None


@dataclass(frozen=True, slots=True)
class Prediction:
    """Predicted result of an identification: the standard uncertainties of every joint. `visible` marks the poses that
    see their whole grid; only these are used. `names` and `covariance` are those of `Identification`.
    """

    joints: tuple[JointEstimate, ...]
    visible: Bool[np.ndarray, " n"]
    names: tuple[str, ...]
    covariance: Float[np.ndarray, "f f"]
    conditioning: Conditioning
    null_space: tuple[Unidentifiable, ...]


def default_setup(
    chain: Chain,
    home: Float[np.ndarray, " j"],
    camera: Camera,
    size_px: tuple[int, int],
    target: TargetSpec,
    T_flange_camera: Float[np.ndarray, "4 4"],
    *,
    noise_px: float,
    fill: float = 0.5,
    scatter_position_mm: float = 0.0,
    scatter_rotation: float = 0.0,
) -> CameraSetup:
    """Return a rig with the grid straight before the camera at the joint angles `home` (rad), filling a share of the
    image.
    """
    middle = target.points_target().mean(axis=0)
    extent = np.ptp(target.points_target()[:, :2], axis=0) + target.pitch_mm
    depth = float(np.max(extent * [camera.fx_px, camera.fy_px] / np.array(size_px))) / fill
    T_camera_target = transform(np.eye(3), np.array([0.0, 0.0, depth]) - middle)
    T_base_target = forward(chain, home[None])[0] @ T_flange_camera @ T_camera_target
    return CameraSetup(
        camera,
        *size_px,
        noise_px,
        (target,),
        T_flange_camera,
        invert(T_base_target)[None],
        scatter_position_mm,
        scatter_rotation,
    )


def count_visible_points(
    chain: Chain,
    joint_angles: Float[np.ndarray, "n j"],
    rig: CameraSetup,
    target: Int[np.ndarray, " n"] | None = None,
) -> Bool[np.ndarray, " n"]:
    """Return which joint angles (rad) let the camera see the whole grid from its front, tilted no more than detectors
    take.
    """
    return np.array(
        [view is not None for view in _views(chain, joint_angles, rig, _which(joint_angles, target))]
    )


def predict(
    chain: Chain,
    joint_angles: Float[np.ndarray, "n j"],
    rig: CameraSetup,
    target: Int[np.ndarray, " n"] | None = None,
) -> Prediction:
    """Predict how well images at these joint angles (rad) would determine the robot's parameters; `target` is the grid
    that each looks at.

    Raises TooFewPoses where too few of them see their grid.
    """
    which = _which(joint_angles, target)
    views = _views(chain, joint_angles, rig, which)
    seen = np.array([view is not None for view in views])
    unknown = 4 * len(chain) + 6 * len(rig.targets)
    if 6 * int(seen.sum()) < 1.2 * unknown or len(np.unique(which[seen])) < len(rig.targets):
        raise TooFewPoses(
            f"{int(seen.sum())} of {len(seen)} poses see their whole grid; they would not determine {unknown} "
            "parameters.",
            "Bring the grid and the poses together: move the grid nearer the middle of the poses, or add poses.",
        )
    stack = stack_views([view for view in views if view is not None])
    T = np.linalg.inv(_camera_poses(chain, joint_angles[seen], rig, which[seen]))
    lens = np.tile(rig.camera.as_array(), (len(T), 1))
    centroids = np.einsum("kij,kj->ki", T[:, :3, :3], stack.centroids) + T[:, :3, 3]
    everything = np.ones(len(stack.column), dtype=np.bool_)
    images = ImageObservations(stack, everything, 1.0, rig.lens, joint_angles[seen], which[seen], ())
    ready = observations_of(
        linearise_images(images, Placements(lens, np.ascontiguousarray(T[:, :3, :3]), centroids)).poses
    )
    arm = ArmState(chain.as_array(), rig.T_flange_camera, rig.T_target_base, np.zeros(ready.layout.shared))
    scatter = Variances(
        max(rig.scatter_position_mm**2, SMALLEST.position), max(rig.scatter_rotation**2, SMALLEST.rotation)
    )
    gauge = fix_gauge(arm, ready, scatter)
    J = linearised(arm, ready)[1]
    all_poses = np.ones(len(ready), dtype=np.bool_)
    free = gauge.free.copy()
    free[arm.layout.kinematic :] = True
    kinematic = int(gauge.free.sum())
    covariance = covariance_of(information_of(ready, J, free, all_poses, scatter))[:kinematic, :kinematic]
    keys = arm.layout.keys()
    return Prediction(
        joints=joint_estimates(arm, gauge, covariance, chain, joint_angles[seen]),
        visible=seen,
        names=tuple(keys[c] for c in np.flatnonzero(gauge.free)),
        covariance=covariance,
        conditioning=conditioning(arm, J, gauge.free, all_poses),
        null_space=gauge.unidentifiable,
    )


def suggest_poses(
    chain: Chain,
    joint_angles: Float[np.ndarray, "n j"],
    candidates: Float[np.ndarray, "c j"],
    rig: CameraSetup,
    count: int,
    target: Int[np.ndarray, " n"] | None = None,
) -> Int[np.ndarray, " s"]:
    """Return which candidates to add to the poses at `joint_angles`, in the order of what they add; fewer than `count`
    where no more of them see the first grid.
    """
    arm = ArmState(chain.as_array(), rig.T_flange_camera, rig.T_target_base, np.zeros(0))
    open_ones = np.flatnonzero(count_visible_points(chain, candidates, rig))
    which = _which(joint_angles, target)
    at = np.concatenate([joint_angles, candidates[open_ones]])
    of = np.concatenate([which, np.zeros(len(open_ones), dtype=np.intp)])
    seen = _exact(arm, at, of)
    gauge = fix_gauge(arm, seen, DEFAULT_SCATTER)
    J = scaled(arm, linearised(arm, seen)[1])[gauge.free].transpose(2, 1, 0)
    base, pool = J[: len(joint_angles)], J[len(joint_angles) :]
    M = np.einsum("nmp,nmq->pq", base, base)
    M = M + 1e-9 * np.trace(M) / len(M) * np.eye(len(M))  # directions that no pose determines yet count first
    chosen: list[int] = []
    left = np.ones(len(pool), dtype=np.bool_)
    while len(chosen) < min(count, len(pool)):
        gained = np.linalg.slogdet(np.eye(6) + pool @ np.linalg.solve(M, pool.transpose(0, 2, 1)))[1]
        best = int(np.argmax(np.where(left, gained, -np.inf)))
        chosen.append(best)
        left[best] = False
        M = M + pool[best].T @ pool[best]
    return open_ones[chosen]


def _which(
    joint_angles: Float[np.ndarray, "n j"], target: Int[np.ndarray, " n"] | None
) -> Int[np.ndarray, " n"]:
    return np.zeros(len(joint_angles), dtype=np.intp) if target is None else target


def _camera_poses(
    chain: Chain, joint_angles: Float[np.ndarray, "n j"], rig: CameraSetup, target: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n 4 4"]:
    return np.asarray(rig.T_target_base[target] @ forward(chain, joint_angles) @ rig.T_flange_camera)


def _views(
    chain: Chain, joint_angles: Float[np.ndarray, "n j"], rig: CameraSetup, target: Int[np.ndarray, " n"]
) -> list[GridPoints | None]:
    """Return what a perfect detector would find at each pose; None where the grid is not all in view, with a pitch of
    its margin.
    """
    views: list[GridPoints | None] = []
    largest = np.array([rig.width_px, rig.height_px]) - 1.0
    for T, t in zip(_camera_poses(chain, joint_angles, rig, target), target, strict=True):
        spec = rig.targets[int(t)]
        points = spec.points_target()
        low, high = points.min(axis=0) - spec.pitch_mm, points.max(axis=0) + spec.pitch_mm
        outline = [[x, y, 0.0] for x in (low[0], high[0]) for y in (low[1], high[1])]
        T_camera_target = invert(T)
        in_camera = transform_points(T_camera_target, np.concatenate([points, outline]))
        # The target's z points into the board: seen from its front, it points away from the camera.
        facing = float(T_camera_target[2, 2]) > math.cos(LARGEST_TILT)
        if not facing or float(in_camera[:, 2].min()) <= 0.0:
            views.append(None)
            continue
        pixels = project(in_camera, rig.camera)
        if np.any(pixels < 0.0) or np.any(pixels > largest):
            views.append(None)
            continue
        pixels = np.ascontiguousarray(pixels[: len(points)])
        row, column = (a.ravel() for a in np.mgrid[0 : spec.grid_rows, 0 : spec.grid_columns])
        noise = np.full(len(pixels), rig.noise_px)
        views.append(GridPoints(spec, rig.width_px, rig.height_px, column, row, pixels, noise))
    return views


def _exact(
    arm: ArmState, joint_angles: Float[np.ndarray, "n j"], target: Int[np.ndarray, " n"]
) -> Observations:
    """Return poses that the arm attains, of an instrument without noise."""
    T = arm.T_target_base[target] @ forward(arm.chain, joint_angles) @ arm.T_flange_camera
    n = len(T)
    return Observations(
        np.ascontiguousarray(joint_angles),
        T[:, :3, 3],
        T[:, :3, :3],
        np.zeros((n, 6, 6)),
        np.zeros((n, 6, 0)),
        target,
    )
