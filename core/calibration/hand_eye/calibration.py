"""Hand-eye calibration: the camera in the flange frame and the targets in the robot's base frame.

    T_base_flange = T_base_target @ T_target_camera @ T_camera_flange

holds for what each pose *attained*; what was commanded differs from it by the robot's deviation, position and rotation
vector in the base frame, of unknown standard deviations s_p and s_r along each axis. Least squares over both unknown
transforms,

    min Σ eᵢᵀ Vᵢ⁻¹ eᵢ,      e = (p_commanded - p_attained, log(R_commanded R_attainedᵀ)),
    Vᵢ = diag(s_p² I, s_r² I) + Gᵢ Σᵢ Gᵢᵀ,

with Σᵢ the measured pose's covariance and Gᵢ what it does to the attained one. s_p and s_r are variance components
estimated by restricted maximum likelihood (both normal equations of the residuals, the fixed point of score = 0).
Each eᵢ is whitened rotation first, then position given rotation: two independent vectors of three for the solver.

An error that all measured poses share, the lens's, is no noise: it shifts the frames, mostly T_flange_camera, and
hardly the deviations. It is carried through to first order where the stations say what it does to them.

A pose that belongs to another image, or a target whose origin was taken for the opposite corner, is beyond 4 MAD of the
others, and improbable as one of them (`outlying_poses`). It is rejected from the fit and stays in the result, marked.
With fewer than six poses none is rejected.

The commanded poses serve twice: to tie the frames, and to be compared with. The fit follows each of them a little, so
deviations come out too small, by as much as sqrt(1 - 12/6n); each deviation is therefore also given held out, as it is
with the frames tied by all the other poses.

References: F. Dornaika, R. Horaud, "Simultaneous robot-world and hand-eye calibration", IEEE Trans. Robotics and
Automation 14 (1998) 617-622, 10.1109/70.704233; H. D. Patterson, R. Thompson, "Recovery of inter-block information
when block sizes are unequal", Biometrika 58 (1971) 545-554, 10.1093/biomet/58.3.545.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from core.calibration.hand_eye.answer_checks import check_answer, warnings_of
from core.calibration.hand_eye.deviations import FramesFit, SharedErrors, deviations_of, shared_motions
from core.calibration.hand_eye.initialisation import (
    MIN_POSES,
    check_count,
    check_poses,
    start_of,
)
from core.calibration.hand_eye.model import (
    MIN_ROBOT_SIGMAS,
    Frames,
    PoseArrays,
    jacobian,
    measurement_covariance,
    pose_variances,
    residuals,
    whitening,
)
from core.calibration.hand_eye.outlying_poses import most_credible
from core.calibration.hand_eye.result import (
    HandEyeCalibration,
    HandEyeObservation,
)
from core.calibration.hand_eye.scale_difference import scale_difference
from core.errors import InvalidArgument, MotionInsufficient, NotConverged
from core.geometry import hats
from core.numerics import REJECTION, Fit, LinearResiduals, Variances, estimate_variances, fit

MIN_POSES_TO_REJECT = 6
"""With fewer poses than this no pose is identified as an outlier."""
MEDIAN_LENGTH = 1.538172
"""The median length of three independent standard normals."""


def calibrate_hand_eye(stations: Sequence[HandEyeObservation]) -> HandEyeCalibration:
    """Estimate T_flange_camera and T_base_target, one for each target, from commanded poses and measured ones.

    A camera that stands still before a target on the flange is the same problem: with T_camera_target in place of
    T_target_camera the answers are T_flange_target and T_base_camera.

    Raises InvalidArgument for poses that are not rigid motions or contradict each other, MotionInsufficient where
    the poses do not determine the frames (the detail says which part), NotConverged where no frames explain most poses.
    """
    poses = _arrays(stations)
    check_count(len(stations))
    check_poses(poses)
    start = start_of(poses)
    enough = len(stations) >= MIN_POSES_TO_REJECT
    frames, used = _robust(start, poses) if enough else (start, np.ones(len(stations), dtype=np.bool_))
    for _ in range(4):
        found = _plain(frames, poses, used)
        frames = found.frames
        within = _within(found, poses) if enough else used
        if np.array_equal(within, used):
            break
        used = within
    while (credible := _most_credible(found, poses, used)) is not None:
        used = used.copy()
        used[credible] = True
        found = _plain(found.frames, poses, used)
    distance = float(np.median(np.linalg.norm(poses.T_target_camera[used, :3, 3], axis=1)))
    warnings = warnings_of(
        found.robot.deviations, distance, [s.pose_id for s, u in zip(stations, used, strict=True) if not u]
    )
    check_answer(found, distance, warnings)
    scale = scale_difference(found, poses, used, shared_motions(found.frames, stations, poses))
    shared = SharedErrors.of(found, stations, poses, used)
    return HandEyeCalibration(
        T_flange_camera=found.frames.T_flange_camera,
        T_base_targets=found.frames.T_base_targets,
        covariance=found.covariance + shared.frames @ shared.frames.T,
        covariance_given_camera=found.covariance,
        robot_position_mm=found.robot.deviations[0],
        robot_rotation=found.robot.deviations[1],
        degrees_of_freedom=_surplus(poses, used),
        deviations=deviations_of(found, shared, stations, poses, used),
        warnings=tuple(warnings),
        common=shared.frames,
        scale=scale,
    )


def _arrays(stations: Sequence[HandEyeObservation]) -> PoseArrays:
    if not stations:
        raise MotionInsufficient("There are no commanded poses to tie the frames with.")
    covariance = np.array([np.zeros((6, 6)) if s.covariance is None else s.covariance for s in stations])
    if not np.all(np.isfinite(covariance)) or np.any(np.linalg.eigvalsh(covariance)[:, 0] < -1e-9):
        raise InvalidArgument("Covariances of measured poses must be finite and not negative.")
    return PoseArrays(
        np.array([s.T_base_flange for s in stations]),
        np.array([s.T_target_camera for s in stations]),
        covariance,
        _targets(stations),
    )


def _targets(stations: Sequence[HandEyeObservation]) -> Int[np.ndarray, " n"]:
    """Return the place of each station's target; every target has a station, or InvalidArgument is raised."""
    target = np.array([s.target for s in stations], dtype=np.intp)
    if not np.array_equal(np.unique(target), np.arange(target.max() + 1)):
        raise InvalidArgument("Targets must be numbered from 0, without a gap.")
    return target


def _at_least(variances: Float[np.ndarray, "2"]) -> Variances:
    """Return the variances of position and rotation, none below the smallest of a robot."""
    position, rotation = variances.tolist()
    return Variances(max(position, MIN_ROBOT_SIGMAS.position), max(rotation, MIN_ROBOT_SIGMAS.rotation))


def _fit(start: Frames, poses: PoseArrays, robot: Variances, *, expected: float) -> Fit[Frames]:
    """Fit with the weights of `robot`; `expected` is the residual scale up to which no outliers are sought."""
    W = whitening(pose_variances(start, poses, robot))
    count = len(W)

    def evaluate(frames: Frames) -> tuple[Float[np.ndarray, "3 m"], Float[np.ndarray, "p 3 m"]]:
        e, J = residuals(frames, poses), jacobian(frames, poses.T_target_camera, poses.target)
        # log(E exp(-δ)) = e - (1 + [e]×/2 + ...) δ.
        J[:, 3:] += 0.5 * hats(e[:, 3:]) @ J[:, 3:]
        whitened = np.einsum("nij,nj->ni", W, e).reshape(2 * count, 3)
        derivative = (W @ J).reshape(2 * count, 3, frames.size)
        return whitened.T.copy(), np.ascontiguousarray(derivative.transpose(2, 1, 0))

    return fit(
        evaluate,
        Frames.moved,
        start,
        np.full(2 * count, expected),
        smallest_scale=expected,
    )


def _robust(start: Frames, poses: PoseArrays) -> tuple[Frames, Bool[np.ndarray, " n"]]:
    """Return frames and inlier stations: weights from the medians, then Cauchy's."""
    lengths = np.linalg.norm(residuals(start, poses).reshape(-1, 2, 3), axis=2)
    medians = np.median(lengths, axis=0) / MEDIAN_LENGTH
    robot = _at_least(medians**2)
    # Less is expected than the medians say, so that the solver does not pass over its robust stage.
    result = _fit(start, poses, robot, expected=0.2)
    used: Bool[np.ndarray, " n"] = np.all(result.used.reshape(-1, 2), axis=1)
    return result.state, used


def _plain(start: Frames, poses: PoseArrays, used: Bool[np.ndarray, " n"]) -> FramesFit:
    """Fit the stations used, with the robot's deviations estimated from them."""
    if int(used.sum()) < max(MIN_POSES, 0.5 * len(used)):
        raise NotConverged(
            f"Only {int(used.sum())} of {len(used)} poses agree on where the camera and the target are.",
            "Check that commanded and measured poses belong together, and that all measure the same point (of an "
            "unmarked target, that its origin is the same in all images).",
        )
    part = poses.part(used)
    square = residuals(start, part).reshape(-1, 2, 3) ** 2
    robot = _at_least(square.mean(axis=(0, 2)))
    frames = start
    for _ in range(5):
        former = robot
        left = LinearResiduals(
            measurement_covariance(frames, part),
            residuals(frames, part),
            jacobian(frames, part.T_target_camera, part.target),
        )
        robot = estimate_variances([left], robot, MIN_ROBOT_SIGMAS)
        result = _fit(frames, part, robot, expected=1.0)
        if result.status == "singular":
            raise MotionInsufficient("The poses do not determine the frames.")
        if not result.converged:
            raise NotConverged(
                "No camera on the flange and target in the base explains the poses.",
                "Check that commanded poses and images belong together.",
            )
        frames = result.state
        if robot.near(former, 1e-2):
            break
    return FramesFit(frames, result.covariance, robot)


def _within(found: FramesFit, poses: PoseArrays) -> Bool[np.ndarray, " n"]:
    """Return which stations are inliers: within the solver's rejection distance by the deviations found."""
    W = whitening(pose_variances(found.frames, poses, found.robot))
    halves = np.einsum("nij,nj->ni", W, residuals(found.frames, poses)).reshape(-1, 2, 3)
    limit = REJECTION * MEDIAN_LENGTH
    within: Bool[np.ndarray, " n"] = np.all(np.linalg.norm(halves, axis=2) <= limit, axis=1)
    return within


def _surplus(poses: PoseArrays, used: Bool[np.ndarray, " n"]) -> float:
    """Return the degrees of freedom of either variance, 1 or more.

    Positions and rotations share the surplus, since either has a deviation of its own, and the weight between the two
    follows from the same few residuals.
    """
    targets = int(poses.target.max()) + 1
    return max(3.0 * (float(used.sum()) - targets) - 4.0, 1.0)


def _most_credible(found: FramesFit, poses: PoseArrays, used: Bool[np.ndarray, " n"]) -> int | None:
    """Return the pose not used that may be one of the others, or None."""
    if np.all(used):
        return None
    J = jacobian(found.frames, poses.T_target_camera, poses.target)
    V = pose_variances(found.frames, poses, found.robot) + J @ found.covariance @ J.swapaxes(1, 2)
    parts = np.stack([V[:, :3, :3], V[:, 3:, 3:]], axis=1)
    e = residuals(found.frames, poses).reshape(-1, 2, 3)
    return most_credible(e, parts, used, _surplus(poses, used))
