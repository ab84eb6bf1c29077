"""Identification on the grid points themselves: lens, tool, base, targets and chain from all images together.

Poses estimated first and a chain fitted to them afterwards lose twice: what the chain knows of where the camera was
never reaches the lens, and the lens's error bends all poses alike. Here every image is linearised where lens and chain
put it (`image_poses`), which makes poses with one lens in common of the images, and that is what `refinement` takes. So
the pass is: linearise, refine, move lens and images to where the answer puts them, until the lens rests. A robot's own
scatter is in it as it is with poses: the image is moved to its best place between chain and measurement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from core.calibration.model import SMALLEST_NOISE_PX, Lens
from core.calibration.pooled import fit_common_camera
from core.calibration.shared_lens import coordinates, linearise, moved
from core.calibration.systematic import Growth, growth_of_shared
from core.calibration.view_stack import Placements, stack_views
from core.camera import Camera
from core.errors import InvalidArgument, NotConverged
from core.kinematics.dh import Chain, forward
from core.kinematics.identification import Identification, begin_at, report, solve
from core.kinematics.image_poses import Images, poses_of_images
from core.kinematics.parameters import ArmState
from core.kinematics.problem import Observations, observations_of, placed
from core.kinematics.refinement import Refined
from core.kinematics.validation import FOLDS
from core.targets.specification import GridPoints
from core.transforms import rotations_from_vectors

PASSES = 12
RESTS = 0.05  # of its own standard uncertainty: a smaller step of the lens is none
LEAST_SHARE = 0.5  # of an image's points that fit one pose


@dataclass(frozen=True, slots=True)
class PointsIdentification:
    """A robot and the lens it was measured with, from the same images.

    `images` are the views that count, ascending; `robot.used` and `robot.residuals` run over them. `camera_covariance`
    has the order of `CAMERA_PARAMETERS`, `T_target_camera` is one per image, at its best place.
    """

    robot: Identification
    camera: Camera
    camera_covariance: Float[np.ndarray, "9 9"]
    images: Int[np.ndarray, " k"]
    T_target_camera: Float[np.ndarray, "k 4 4"]
    rms_px: float


def identify_on_points(
    views: Sequence[GridPoints],
    joint_angles: Float[np.ndarray, "n j"],
    nominal: Chain | None = None,
    *,
    target: Int[np.ndarray, " n"] | None = None,
    start: Chain | None = None,
    lens: Lens | None = None,
    labels: tuple[str, ...] = (),
    folds: int = FOLDS,
) -> PointsIdentification:
    """Identify robot and lens from the grid points of images taken with one lens at known joint angles (rad).

    Parameters: as of `identify`; `target` is the index of the target that each view shows, `lens` a 5 % prior on the
    focal length, `labels` the images' names.

    Raises InvalidArgument for no views or mixed image sizes, DegenerateGeometry, NotConverged where no common lens
    explains the images, and what `identify` raises.
    """
    stack = stack_views(views)
    if len(joint_angles) != len(views):
        raise InvalidArgument(f"There are {len(views)} images and {len(joint_angles)} sets of joint angles.")
    shared = fit_common_camera(stack, lens)
    if not shared.converged:
        raise NotConverged(
            "No common lens explains the images.", "Check that all were taken with one setting of the camera."
        )
    whole = stack.sums(shared.used.astype(np.float64)) >= LEAST_SHARE * stack.counts
    in_front = shared.at.placements.translations_mm[:, 2] > 0.0
    images = np.flatnonzero(shared.kept & whole & in_front)
    seen = Images(
        stack.take(images),
        shared.used[stack.spread(np.isin(np.arange(len(stack)), images))],
        max(shared.scale, SMALLEST_NOISE_PX / float(stack.uncertainty.mean())),
        lens,
        np.ascontiguousarray(joint_angles[images]),
        np.zeros(len(images), dtype=np.intp) if target is None else target[images],
        tuple(labels[i] for i in images) if labels else (),
        _alike_in_all(growth_of_shared(stack, shared, np.arange(len(stack))), len(images)),
    )
    return _identified(seen, shared.at.placements.take(images), images, nominal, start, folds)


def _alike_in_all(growth: Growth, images: int) -> Growth:
    """Return the growth where what makes each image's own camera scatter is the same in all images.

    A bow of the print, or what a lens has beyond its model, pulls the cameras of images apart as their views differ,
    and all of them one way besides. That part no residual shows, and it does not grow less with the number of images:
    against noise, which does, it counts so many times. The lens's errors before a bowed grid are then 1.2 times what is
    stated (rms; 36 images, a robot that scatters), without it 3.5 times. A chain that is exact finds the lens all the
    same.
    """
    return Growth(1.0 + images * (growth.camera - 1.0), growth.own)


def _identified(
    seen: Images,
    placements: Placements,
    images: Int[np.ndarray, " k"],
    nominal: Chain | None,
    start: Chain | None,
    folds: int,
) -> PointsIdentification:
    arm, scatter, gauge = None, None, None
    for _ in range(PASSES):
        at = poses_of_images(seen, placements)
        ready = observations_of(at.poses)
        if arm is None:
            begin = begin_at(at.poses, nominal, start)
            arm = placed(begin.as_array(), forward(begin, at.poses.joint_angles), ready)
        else:
            arm = replace(arm, shared=np.zeros(ready.layout.shared))
        solution = solve(arm, ready, at.poses, scatter, gauge)
        refined = solution.refined
        arm, scatter, gauge = refined.arm, refined.scatter, solution.gauge
        step = at.step + at.root @ arm.shared[:8]
        T_target_camera = _attained(refined, ready)
        placements = _moved(seen, placements, step, T_target_camera)
        of_lens = refined.covariance[-len(arm.shared) :, -len(arm.shared) :][:8, :8]
        covariance = at.root @ of_lens @ at.root.T
        if math.sqrt(float(step @ np.linalg.solve(covariance, step))) < RESTS:
            break
    else:
        raise NotConverged("Lens and robot did not come to rest together.")
    by_step = np.zeros((9, 8))
    by_step[:8] = coordinates(placements.parameters[0])
    left = linearise(seen.views, placements, seen.used).residuals[:, seen.used]
    return PointsIdentification(
        robot=report(solution, ready, at.poses, nominal, folds),
        camera=Camera.from_array(placements.parameters[0]),
        camera_covariance=by_step @ covariance @ by_step.T,
        images=images,
        T_target_camera=T_target_camera,
        rms_px=math.sqrt(float(np.mean(np.sum(left**2, axis=0)))),
    )


def _attained(refined: Refined, ready: Observations) -> Float[np.ndarray, "k 4 4"]:
    """Return where the camera was: between chain and image as their uncertainties have it; by the image alone where it
    was left out.
    """
    arm: ArmState = refined.arm
    S = np.diag(refined.scatter.diagonal(6))
    gain = S @ np.linalg.inv(ready.own + S)
    gain[~refined.used] = np.eye(6)
    # The image's pose at this lens, and from there back by what is not the robot's own.
    correction = -np.einsum("kab,b->ka", ready.common, arm.shared)
    correction -= np.einsum("kab,bk->ka", np.eye(6) - gain, refined.residuals)
    assert ready.rotations is not None
    T = np.broadcast_to(np.eye(4), (len(ready), 4, 4)).copy()
    T[:, :3, :3] = rotations_from_vectors(correction[:, 3:]) @ ready.rotations
    T[:, :3, 3] = ready.positions_mm + correction[:, :3]
    return T


def _moved(
    seen: Images,
    placements: Placements,
    step: Float[np.ndarray, "8"],
    T_target_camera: Float[np.ndarray, "k 4 4"],
) -> Placements:
    """Return the images with the lens after a step, at these poses."""
    lens = moved(placements, np.tile(step, (len(placements), 1)), np.zeros((len(placements), 6)))
    rotations = np.ascontiguousarray(T_target_camera[:, :3, :3].transpose(0, 2, 1))
    arms = seen.views.centroids - T_target_camera[:, :3, 3]
    return Placements(lens.parameters, rotations, np.einsum("kij,kj->ki", rotations, arms))
