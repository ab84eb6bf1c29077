"""Identification on the grid points themselves: lens, tool, base, targets and chain from all images together.

Poses estimated first and a chain fitted to them afterwards lose twice: what the chain knows of where the camera was
never reaches the lens, and the lens's error bends all poses in the same way. Here every image is linearised where lens
and chain put it (`image_linearisation`), which turns images into poses with one common lens, as the global fit takes
them. A pass is: linearise, fit, move lens and images to where the result puts them; passes end when the lens no longer
moves. The robot's own scatter is handled as with poses: each image is moved to its best place between chain and
measurement.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from core.calibration import CommonFit, Placements, VarianceInflation, coordinates, linearise, moved
from core.errors import InvalidArgument, NotConverged
from core.geometry import AnyCamera, camera_from_array, rotations_from_vectors
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import Chain, forward
from core.kinematics.global_fit import (
    FOLDS,
    FitResult,
    ImageObservations,
    Observations,
    linearise_images,
    observations_of,
    placed,
)
from core.kinematics.identification.extension import ModelChoice
from core.kinematics.identification.from_poses import initial_chain, report, solve
from core.kinematics.identification.result import Identification

MAX_OUTER_ITERATIONS = 12
CONVERGENCE_TOLERANCE = (
    0.05  # of its own standard uncertainty: a smaller step of the lens counts as convergence
)


@dataclass(frozen=True, slots=True)
class ImageIdentification:
    """A robot and the lens it was measured with, from the same images.

    `camera_covariance` has the order of the lens model's `LENS_PARAMETERS`, `T_target_camera` is one per image,
    at its best place.
    """

    robot: Identification
    camera: AnyCamera
    camera_covariance: Float[np.ndarray, "s s"]
    T_target_camera: Float[np.ndarray, "k 4 4"]
    rms_px: float


def identify_from_images(
    fit: CommonFit,
    joint_angles: Float[np.ndarray, "k j"],
    nominal: Chain | None = None,
    *,
    target: Int[np.ndarray, " k"] | None = None,
    start: Chain | None = None,
    labels: tuple[str, ...] = (),
    folds: int = FOLDS,
    model: ModelChoice = ModelChoice.DH,
    trials: int = 0,
    approach: Float[np.ndarray, "k j"] | None = None,
) -> ImageIdentification:
    """Identify robot and lens from the grid points of images taken with one lens at known joint angles (rad).

    Parameters: as of `identify`; `fit` is that of one camera to the images (`core.calibration.estimate_group`),
    `target` the index of the target that each image shows, `labels` the images' names, `approach` as of `PoseData`.

    Raises InvalidArgument, DegenerateGeometry, NotConverged where lens and robot do not converge together, and what
    `identify` raises.
    """
    count = len(fit.views)
    if len(joint_angles) != count:
        raise InvalidArgument(f"There are {count} images and {len(joint_angles)} sets of joint angles.")
    seen = ImageObservations(
        fit.views,
        fit.used,
        fit.scale,
        fit.lens,
        np.ascontiguousarray(joint_angles),
        np.zeros(count, dtype=np.intp) if target is None else target,
        labels,
        _with_common_deformation(fit.growth, len(np.unique(fit.pose))),
        approach,
    )
    return _identified(seen, fit.placements, nominal, start, folds, model, trials)


def _with_common_deformation(growth: VarianceInflation, poses: int) -> VarianceInflation:
    """Return the growth for a cause that is common to all images.

    A bow of the print, or an error of the lens model, makes the cameras of single poses scatter, and shifts all of them
    by a common part. No residual shows the common part, and it does not shrink with the number of poses as noise does:
    its share of the variance is therefore multiplied by that number. The lens's errors before a bowed grid are then 1.2
    times the stated uncertainty (rms; 36 poses, a robot that scatters), without this factor 3.5 times. An exact chain
    finds the lens in either case.
    """
    return VarianceInflation(1.0 + poses * (growth.camera - 1.0), growth.own)


def _identified(
    seen: ImageObservations,
    placements: Placements,
    nominal: Chain | None,
    start: Chain | None,
    folds: int,
    model: ModelChoice,
    trials: int,
) -> ImageIdentification:
    arm, scatter, gauge = None, None, None
    for _ in range(MAX_OUTER_ITERATIONS):
        at = linearise_images(seen, placements)
        ready = observations_of(at.poses)
        if arm is None:
            begin = initial_chain(at.poses, nominal, start)
            arm = placed(begin.as_array(), forward(begin, at.poses.joint_angles), ready)
        else:
            arm = replace(arm, shared=np.zeros(ready.layout.shared))
        solution = solve(arm, ready, at.poses, nominal, scatter, gauge)
        refined = solution.refined
        arm, scatter, gauge = refined.arm, refined.scatter, solution.gauge
        lens = len(at.step)
        step = at.step + at.root @ arm.shared[:lens]
        T_target_camera = _attained(refined, ready)
        placements = _moved(seen, placements, step, T_target_camera)
        of_lens = refined.covariance[-len(arm.shared) :, -len(arm.shared) :][:lens, :lens]
        covariance = at.root @ of_lens @ at.root.T
        if math.sqrt(float(step @ np.linalg.solve(covariance, step))) < CONVERGENCE_TOLERANCE:
            break
    else:
        raise NotConverged("The joint fit of lens and robot did not converge.")
    by_step = np.zeros((placements.parameters.shape[1], lens))
    by_step[:lens] = coordinates(placements.parameters[0])
    left = linearise(seen.views, placements, seen.used).residuals[:, seen.used]
    return ImageIdentification(
        robot=report(solution, ready, at.poses, nominal, folds, model, trials),
        camera=camera_from_array(placements.parameters[0]),
        camera_covariance=by_step @ covariance @ by_step.T,
        T_target_camera=T_target_camera,
        rms_px=math.sqrt(float(np.mean(np.sum(left**2, axis=0)))),
    )


def _attained(refined: FitResult, ready: Observations) -> Float[np.ndarray, "k 4 4"]:
    """Return where the camera was: between chain and image as their uncertainties have it; by the image alone where it
    was rejected.
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
    seen: ImageObservations,
    placements: Placements,
    step: Float[np.ndarray, " c"],
    T_target_camera: Float[np.ndarray, "k 4 4"],
) -> Placements:
    """Return the images with the lens after a step, at these poses."""
    lens = moved(placements, np.tile(step, (len(placements), 1)), np.zeros((len(placements), 6)))
    rotations = np.ascontiguousarray(T_target_camera[:, :3, :3].transpose(0, 2, 1))
    arms = seen.views.centroids - T_target_camera[:, :3, 3]
    return Placements(lens.parameters, rotations, np.einsum("kij,kj->ki", rotations, arms))
