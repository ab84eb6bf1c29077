"""The scale of commanded distances to measured ones: a print of another pitch than stated, an instrument of another
scale, or a robot of other lengths.

With measured translations t multiplied by 1 + s, an attained flange moves by s R_Z t (R_Z of T_base_target), and so
does an attained point. To first order s is one more parameter of the fit: by generalised least squares, the frames
following it, with the robot's variances estimated again with it, since an unknown scale would count as the robot's
scatter.

A robot's own errors are smooth: over a small region they are an affine map of the place, whose part along p resembles a
scale. Its other parts, which no rigid motion and no scale has, are as large: how large a scale they would be is stated
with the scale (`like_of_robot`).
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.hand_eye import position_model
from core.calibration.hand_eye.deviations import FramesFit
from core.calibration.hand_eye.model import (
    MIN_ROBOT_SIGMAS,
    PoseArrays,
    jacobian,
    measurement_covariance,
    residuals,
)
from core.calibration.hand_eye.result import ScaleDifference
from core.numerics import LinearResiduals, Variances, estimate_variances, scaled_inverse

MIN_AFFINE_SHARE = 0.1
"""Of the largest affine map of the places: one of which frames and scale leave less is not looked at."""


def scale_difference(
    found: FramesFit,
    poses: PoseArrays,
    used: Bool[np.ndarray, " n"],
    shared: Float[np.ndarray, "n 6 k"],
) -> ScaleDifference | None:
    """Return the scale difference; None where the poses do not determine it.

    `shared` is what one standard uncertainty of each error that all poses share does to the attained ones, the frames
    held: a focal length that is off is a scale, too.
    """
    part, frames = poses.part(used), found.frames
    moved = np.einsum(
        "nij,nj->ni", frames.T_base_targets[part.target, :3, :3], part.T_target_camera[:, :3, 3]
    )
    return _by_least_squares(
        measurement_covariance(frames, part),
        residuals(frames, part),
        jacobian(frames, part.T_target_camera, part.target),
        moved,
        part.T_base_flange[:, :3, 3],
        found.robot,
        shared[used],
    )


def position_scale_difference(
    state: position_model.PositionState,
    problem: position_model.PositionProblem,
    deviation_mm: float,
    shared: Float[np.ndarray, "n 3 k"],
) -> ScaleDifference | None:
    """Return the scale difference of commanded positions, else as `scale_difference`; of the stations in `problem`.

    `deviation_mm` is the robot's as fitted. The point in the camera is fitted along: where poses turn about the target
    as far as they move, that takes up what a scale would be.
    """
    J = position_model.jacobian(state, problem)
    return _by_least_squares(
        position_model.measurement(state, problem),
        position_model.residuals(state, problem),
        J,
        problem.measured[:, :3, 3] @ state.T_base_target[:3, :3].T,
        problem.commanded,
        Variances.of_deviations(deviation_mm, MIN_ROBOT_SIGMAS.deviations[1]),
        shared,
    )


def _by_least_squares(
    known: Float[np.ndarray, "n m m"],
    e: Float[np.ndarray, "n m"],
    of_frames: Float[np.ndarray, "n m p"],
    moved_mm: Float[np.ndarray, "n 3"],
    places_mm: Float[np.ndarray, "n 3"],
    robot: Variances,
    shared: Float[np.ndarray, "n m k"],
) -> ScaleDifference | None:
    """Return the scale by residuals `e` at `places_mm`, of covariance `known` and the robot's; a scale of 1 moves them
    by `moved_mm`.
    """
    by_scale = np.zeros((*e.shape, 1))
    by_scale[:, :3, 0] = moved_mm
    J, components = np.concatenate([of_frames, by_scale], axis=2), e.shape[1]
    robot = estimate_variances([LinearResiduals(known, e, J)], robot, MIN_ROBOT_SIGMAS)
    W = np.linalg.inv(known + np.diag(robot.diagonal(components)))
    N = np.einsum("nia,nij,njb->ab", J, W, J)
    try:
        C = scaled_inverse(N)
    except np.linalg.LinAlgError:
        return None
    variance = float(C[-1, -1])
    if not 0.0 < variance < 1.0:
        return None
    weighted = np.einsum("a,nia,nij->nj", C[-1], J, W)
    of_shared = np.einsum("nj,njk->k", weighted, shared)
    value = float(np.einsum("nj,nj->", weighted, e))
    return ScaleDifference(
        value,
        math.sqrt(variance + float(of_shared @ of_shared)),
        math.sqrt(variance) * _affine_rms(W, e, J, places_mm),
    )


def _affine_rms(
    W: Float[np.ndarray, "n m m"],
    e: Float[np.ndarray, "n m"],
    J: Float[np.ndarray, "n m p"],
    places_mm: Float[np.ndarray, "n 3"],
) -> float:
    """Return the root mean square of the weighted residuals along affine maps of the places that neither frames nor
    scale can be, in standard deviations; 0 without such maps.
    """
    about = places_mm - places_mm.mean(axis=0)
    maps = np.zeros((*e.shape, 9))
    for i in range(3):
        maps[:, i, 3 * i : 3 * i + 3] = about
    whitening = np.linalg.cholesky(W).swapaxes(1, 2)
    fitted, affine = ((whitening @ x).reshape(e.size, -1) for x in (J, maps))
    fitted = fitted / np.maximum(np.linalg.norm(fitted, axis=0), 1e-300)
    U, lengths, _ = np.linalg.svd(fitted, full_matrices=False)
    basis = U[:, lengths > 1e-9 * lengths[0]]
    left = affine - basis @ (basis.T @ affine)
    own, sizes, _ = np.linalg.svd(left, full_matrices=False)
    own = own[:, sizes > MIN_AFFINE_SHARE * np.linalg.norm(affine, axis=0).max()]
    if not own.shape[1]:
        return 0.0
    return math.sqrt(float(np.mean((own.T @ np.einsum("nij,nj->ni", whitening, e).ravel()) ** 2)))
