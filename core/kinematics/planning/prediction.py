"""Predicted uncertainties of an identification: the images that a camera would take at given joint angles, linearised.

Their grid points, with the noise that a detector has, give the covariance of every pose and of the lens; with the
robot's own scatter these give the covariance of every parameter, as `identification` will state it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration import Placements, stack_views
from core.errors import TooFewPoses
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import Chain
from core.kinematics.global_fit import (
    Conditioning,
    Unidentifiable,
    conditioning,
    fix_gauge,
    information_of,
    linearised,
    observations_of,
)
from core.kinematics.planning.camera_setup import CameraSetup, camera_poses, views_of
from core.kinematics.planning.image_linearisation import linearise_images
from core.kinematics.results import JointEstimate, joint_estimates
from core.numerics import SMALLEST, Variances, covariance_of


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


def predict(chain: Chain, joint_angles: Float[np.ndarray, "n j"], rig: CameraSetup) -> Prediction:
    """Predict how well images at these joint angles (rad) would determine the robot's parameters.

    Raises TooFewPoses where too few of them see the grid.
    """
    views = views_of(chain, joint_angles, rig)
    seen = np.array([view is not None for view in views])
    unknown = 4 * len(chain) + 6
    if 6 * int(seen.sum()) < 1.2 * unknown:
        raise TooFewPoses(
            f"{int(seen.sum())} of {len(seen)} poses see their whole grid; they would not determine {unknown} "
            "parameters.",
            "Bring the grid and the poses together: move the grid nearer the middle of the poses, or add poses.",
        )
    stack = stack_views([view for view in views if view is not None])
    T = np.linalg.inv(camera_poses(chain, joint_angles[seen], rig))
    lens = np.tile(rig.camera.as_array(), (len(T), 1))
    centroids = np.einsum("kij,kj->ki", T[:, :3, :3], stack.centroids) + T[:, :3, 3]
    placements = Placements(lens, np.ascontiguousarray(T[:, :3, :3]), centroids)
    ready = observations_of(linearise_images(stack, placements, rig.lens, joint_angles[seen]))
    arm = ArmState(
        chain.as_array(), rig.T_flange_camera, rig.T_target_base[None], np.zeros(ready.layout.shared)
    )
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
    open_ones = gauge.by_assumed[gauge.free]
    covariance = covariance + open_ones @ open_ones.T
    keys = arm.layout.keys()
    return Prediction(
        joints=joint_estimates(arm, gauge, covariance, chain, joint_angles[seen]),
        visible=seen,
        names=tuple(keys[c] for c in np.flatnonzero(gauge.free)),
        covariance=covariance,
        conditioning=conditioning(arm, J, gauge.free, all_poses),
        null_space=gauge.unidentifiable,
    )
