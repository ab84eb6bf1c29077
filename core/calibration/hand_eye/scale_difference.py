"""The scale of commanded distances to measured ones: a print of another pitch than stated, or a robot of other lengths.

With measured translations t multiplied by 1 + s, an attained flange moves by s R_Z t (R_Z of T_base_target). To first
order s is one more parameter of the fit: by generalised least squares, the frames following it, with the robot's
variances estimated again with it, since an unknown scale would count as the robot's scatter.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.hand_eye.deviations import FramesFit
from core.calibration.hand_eye.model import (
    MIN_ROBOT_SIGMAS,
    PoseArrays,
    jacobian,
    measurement_covariance,
    pose_variances,
    residuals,
)
from core.calibration.hand_eye.result import ScaleDifference
from core.numerics import LinearResiduals, estimate_variances


def scale_difference(
    found: FramesFit,
    poses: PoseArrays,
    used: Bool[np.ndarray, " n"],
    prior: tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"]],
    shared: Float[np.ndarray, "n 6 k"],
) -> ScaleDifference | None:
    """Return the scale difference; None where the poses do not determine it.

    `prior` is the information that the fit's priors have of the frames, and where they pull these; `shared` is what
    one standard uncertainty of each error that all poses share does to the attained ones, the frames held: a focal
    length that is off is a scale, too.
    """
    part, frames = poses.part(used), found.frames
    measured = part.T_target_camera[:, :3, 3]
    by_scale = np.zeros((len(measured), 6, 1))
    by_scale[:, :3, 0] = np.einsum("nij,nj->ni", frames.T_base_targets[part.target, :3, :3], measured)
    J = np.concatenate([jacobian(frames, part.T_target_camera, part.target), by_scale], axis=2)
    size = J.shape[2]
    information = np.zeros((size, size))
    information[:-1, :-1] = prior[0]
    e = residuals(frames, part)
    left = LinearResiduals(measurement_covariance(frames, part), e, J, prior=information)
    robot = estimate_variances([left], found.robot, MIN_ROBOT_SIGMAS)
    W = np.linalg.inv(pose_variances(frames, part, robot))
    N = np.einsum("nia,nij,njb->ab", J, W, J) + information
    unit = 1.0 / np.sqrt(np.maximum(np.diag(N), 1e-300))
    try:
        C = np.linalg.inv(N * np.outer(unit, unit)) * np.outer(unit, unit)
    except np.linalg.LinAlgError:
        return None
    variance = float(C[-1, -1])
    if not 0.0 < variance < 1.0:
        return None
    weighted = np.einsum("a,nia,nij->nj", C[-1], J, W)
    of_shared = np.einsum("nj,njk->k", weighted, shared[used])
    value = float(np.einsum("nj,nj->", weighted, e) + C[-1, :-1] @ prior[1])
    return ScaleDifference(value, math.sqrt(variance + float(of_shared @ of_shared)))
