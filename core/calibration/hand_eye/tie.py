"""Hand-eye calibration: the camera in the flange and the target in the robot's base, so that accuracy can be told.

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
others; it is left out of the fit and stays in the result, marked. Among fewer than six poses none can be told so.

The commanded poses serve twice: to tie the frames, and to be compared with. The fit follows each of them a little, so
deviations come out too small, by as much as sqrt(1 - 12/6n); each deviation is therefore also given held out, as it is
with the frames tied by all the other poses.

References: F. Dornaika, R. Horaud, "Simultaneous robot-world and hand-eye calibration", IEEE Trans. Robotics and
Automation 14 (1998) 617-622, 10.1109/70.704233; H. D. Patterson, R. Thompson, "Recovery of inter-block information
when block sizes are unequal", Biometrika 58 (1971) 545-554, 10.1093/biomet/58.3.545.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.hand_eye.model import (
    SMALLEST_POSITION_MM,
    SMALLEST_ROTATION,
    Frames,
    PoseArrays,
    hats,
    jacobian,
    measurement_covariance,
    measurement_effect,
    residuals,
    variance_components,
    whitening,
)
from core.calibration.hand_eye.result import Deviation, FrameTie, Mount, Station
from core.calibration.hand_eye.start import LEAST_POSES, check_count, check_motion, check_poses, robust_start
from core.errors import Advisory, InvalidArgument, MotionInsufficient, NotConverged
from core.least_squares import REJECTION, Fit, Prior, fit
from core.transforms import rotation_mean, so3_log, transform

LEAST_TO_JUDGE = 6
"""With fewer poses than this none can be told to be a wrong one."""
LARGE_DEVIATION = 0.01
"""Standard deviation, in rad and of the working distance, from which on a robot is not the likely reason."""
LARGEST_DOUBT = 0.05
"""Largest standard uncertainty of the camera on the flange that is an answer: in rad, and of the working distance."""
MEDIAN_LENGTH = 1.538172
"""The median length of three independent standard normals."""
SMALLEST_ROBOT = (SMALLEST_POSITION_MM, SMALLEST_ROTATION)


def tie_frames(stations: Sequence[Station], *, mount: Mount | None = None) -> FrameTie:
    """Estimate T_flange_camera and T_base_target from commanded poses and measured ones.

    A stated `mount` is a prior: with it poses of like orientation serve too. A camera that stands still before a target
    on the flange is the same problem: with T_camera_target in place of T_target_camera the answers are T_flange_target
    and T_base_camera.

    Raises InvalidArgument for poses that are no rigid motions or tell of different motions, MotionInsufficient where
    the poses do not determine the frames (the detail says which part), NotConverged where no frames explain most poses.
    """
    poses = _arrays(stations)
    check_count(len(stations))
    check_poses(poses.T_base_flange, poses.T_target_camera)
    if mount is None:
        check_motion(poses.T_base_flange)
        start = robust_start(poses)
    else:
        start = _start_from(mount, poses)
    enough = len(stations) >= LEAST_TO_JUDGE
    frames, used = _robust(start, poses, mount) if enough else (start, np.ones(len(stations), dtype=np.bool_))
    for _ in range(4):
        found = _plain(frames, poses, used, mount)
        frames = found.frames
        within = _within(found, poses) if enough else used
        if np.array_equal(within, used):
            break
        used = within
    distance = float(np.median(np.linalg.norm(poses.T_target_camera[used, :3, 3], axis=1)))
    remarks = _remarks(
        found.robot, distance, [s.pose_id for s, u in zip(stations, used, strict=True) if not u]
    )
    _check_answer(found, distance, remarks)
    shared = _Shared.of(found, stations, poses, used)
    deviations = tuple(_deviations(found, shared, stations, poses, used))
    # Positions and rotations share the surplus, since either has a deviation of its own, and the weight between the two
    # is told by the same few residuals.
    surplus = 3.0 * float(used.sum()) - (7.0 if mount is None else 4.0)
    return FrameTie(
        T_flange_camera=found.frames.T_flange_camera,
        T_base_target=found.frames.T_base_target,
        covariance=found.covariance + shared.frames @ shared.frames.T,
        conditional_covariance=found.covariance,
        robot_position_mm=found.robot[0],
        robot_rotation=found.robot[1],
        degrees_of_freedom=max(surplus, 1.0),
        deviations=deviations,
        warnings=tuple(remarks),
    )


@dataclass(frozen=True, slots=True)
class _Found:
    """A fit over the stations used: frames, covariance of the 12, the robot's (s_p, s_r)."""

    frames: Frames
    covariance: Float[np.ndarray, "12 12"]
    robot: tuple[float, ...]


def _arrays(stations: Sequence[Station]) -> PoseArrays:
    if not stations:
        raise MotionInsufficient("There are no commanded poses to tie the frames with.")
    covariance = np.array([np.zeros((6, 6)) if s.covariance is None else s.covariance for s in stations])
    if not np.all(np.isfinite(covariance)) or np.any(np.linalg.eigvalsh(covariance)[:, 0] < -1e-9):
        raise InvalidArgument("Covariances of measured poses must be finite and not negative.")
    return PoseArrays(
        np.array([s.T_base_flange for s in stations]),
        np.array([s.T_target_camera for s in stations]),
        covariance,
    )


def _variances(frames: Frames, poses: PoseArrays, robot: tuple[float, ...]) -> Float[np.ndarray, "n 6 6"]:
    return measurement_covariance(frames, poses) + np.diag(np.repeat(np.square(robot), 3))


def _fit(
    start: Frames, poses: PoseArrays, robot: tuple[float, ...], mount: Mount | None, *, expected: float
) -> Fit[Frames]:
    """Fit with the weights of `robot`; `expected` is the residual scale that raises no suspicion."""
    W = whitening(_variances(start, poses, robot))
    count = len(W)

    def evaluate(frames: Frames) -> tuple[Float[np.ndarray, "3 m"], Float[np.ndarray, "12 3 m"]]:
        e, J = residuals(frames, poses), jacobian(frames, poses.T_target_camera)
        # log(E exp(-δ)) = e - (1 + [e]×/2 + ...) δ.
        J[:, 3:] += 0.5 * hats(e[:, 3:]) @ J[:, 3:]
        whitened = np.einsum("nij,nj->ni", W, e).reshape(2 * count, 3)
        derivative = (W @ J).reshape(2 * count, 3, 12)
        return whitened.T.copy(), np.ascontiguousarray(derivative.transpose(2, 1, 0))

    return fit(
        evaluate,
        Frames.moved,
        start,
        np.full(2 * count, expected),
        prior=None if mount is None else _prior(mount),
        smallest_scale=expected,
    )


def _prior(mount: Mount) -> Prior[Frames]:
    sigma = np.repeat([mount.position_standard_uncertainty_mm, mount.rotation_standard_uncertainty], 3)

    def prior(frames: Frames) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 12"]]:
        expected, here = mount.T_flange_camera, frames.T_flange_camera
        turn = so3_log(expected[:3, :3] @ here[:3, :3].T)
        q = np.concatenate([expected[:3, 3] - here[:3, 3], turn]) / sigma
        return q, np.hstack([np.diag(1.0 / sigma), np.zeros((6, 6))])

    return prior


def _start_from(mount: Mount, poses: PoseArrays) -> Frames:
    """Return the frames with the camera where the drawing says, the target where most poses then see it."""
    placed = poses.T_base_flange @ mount.T_flange_camera @ np.linalg.inv(poses.T_target_camera)
    rotation = rotation_mean(placed[:, :3, :3])
    return Frames(mount.T_flange_camera, transform(rotation, np.median(placed[:, :3, 3], axis=0)))


def _robust(start: Frames, poses: PoseArrays, mount: Mount | None) -> tuple[Frames, Bool[np.ndarray, " n"]]:
    """Return frames and the stations to believe: weights from the medians, then Cauchy's."""
    lengths = np.linalg.norm(residuals(start, poses).reshape(-1, 2, 3), axis=2)
    medians = np.median(lengths, axis=0) / MEDIAN_LENGTH
    robot = tuple(float(s) for s in np.maximum(medians, SMALLEST_ROBOT))
    # Less is expected than the medians say, so that the solver does not pass over its robust stage.
    result = _fit(start, poses, robot, mount, expected=0.2)
    used: Bool[np.ndarray, " n"] = np.all(result.used.reshape(-1, 2), axis=1)
    return result.state, used


def _plain(start: Frames, poses: PoseArrays, used: Bool[np.ndarray, " n"], mount: Mount | None) -> _Found:
    """Fit the stations used, with the robot's deviations estimated from them."""
    if int(used.sum()) < max(LEAST_POSES, 0.5 * len(used)):
        raise NotConverged(
            f"Only {int(used.sum())} of {len(used)} poses agree on where the camera and the target are.",
            "Check that commanded poses and images belong together, and that the target's origin is the same in all.",
        )
    part = poses.part(used)
    square = residuals(start, part).reshape(-1, 2, 3) ** 2
    robot = tuple(float(s) for s in np.maximum(np.sqrt(square.mean(axis=(0, 2))), SMALLEST_ROBOT))
    frames = start
    for _ in range(5):
        former = robot
        Q = np.zeros((1, 12)) if mount is None else _prior(mount)(frames)[1]
        robot = variance_components(
            residuals(frames, part),
            jacobian(frames, part.T_target_camera),
            measurement_covariance(frames, part),
            robot,
            SMALLEST_ROBOT,
            Q.T @ Q,
        )
        result = _fit(frames, part, robot, mount, expected=1.0)
        if result.status == "singular":
            raise MotionInsufficient("The poses do not determine the frames.")
        if not result.converged:
            raise NotConverged(
                "No camera on the flange and target in the base explains the poses.",
                "Check that commanded poses and images belong together.",
            )
        frames = result.state
        if np.allclose(robot, former, rtol=1e-2):
            break
    return _Found(frames, result.covariance, robot)


def _within(found: _Found, poses: PoseArrays) -> Bool[np.ndarray, " n"]:
    """Tell which stations lie within the solver's distance of rejection by the deviations found."""
    W = whitening(_variances(found.frames, poses, found.robot))
    halves = np.einsum("nij,nj->ni", W, residuals(found.frames, poses)).reshape(-1, 2, 3)
    limit = REJECTION * MEDIAN_LENGTH
    within: Bool[np.ndarray, " n"] = np.all(np.linalg.norm(halves, axis=2) <= limit, axis=1)
    return within


def _check_answer(found: _Found, distance: float, remarks: Sequence[Advisory]) -> None:
    """Refuse where the camera on the flange is uncertain beyond what first order can tell.

    Raises MotionInsufficient, or NotConverged where deviations too large for a robot are the reason.
    """
    values, vectors = np.linalg.eigh(found.covariance[:3, :3])
    worst = math.sqrt(values[-1])
    turn = math.sqrt(float(np.linalg.eigvalsh(found.covariance[3:6, 3:6])[-1]))
    if worst > LARGEST_DOUBT * distance or turn > LARGEST_DOUBT:
        for remark in remarks:
            if remark.code == "deviations_large":
                raise NotConverged(f"The frames cannot be tied. {remark.detail}", remark.advice)
        axis = ", ".join(f"{value:.2f}" for value in vectors[:, -1])
        raise MotionInsufficient(
            "The poses hardly determine where the camera sits on the flange: standard uncertainty "
            f"{worst:.3g} mm along ({axis}) of the flange, {math.degrees(turn):.2g}° in rotation."
        )


@dataclass(frozen=True, slots=True)
class _Shared:
    """What the k errors that all stations share do to the frames, and to each attained pose once the frames follow."""

    frames: Float[np.ndarray, "12 k"]
    attained: Float[np.ndarray, "n 6 k"]

    @classmethod
    def of(
        cls, found: _Found, stations: Sequence[Station], poses: PoseArrays, used: Bool[np.ndarray, " n"]
    ) -> _Shared:
        """Attained poses move by G c, the frames by the least squares answer to that."""
        given = [s.common for s in stations]
        sizes = {0 if c is None else c.shape[1] for c in given}
        if len(sizes) != 1:
            raise InvalidArgument("All stations must share the same errors, or none.")
        if sizes == {0}:
            return cls(np.zeros((12, 0)), np.zeros((len(given), 6, 0)))
        moved = measurement_effect(found.frames, poses.T_target_camera) @ np.array(given)
        J = jacobian(found.frames, poses.T_target_camera)
        weighted = np.linalg.inv(_variances(found.frames, poses, found.robot)) @ moved
        frames = -found.covariance @ np.einsum("nij,nik->jk", J[used], weighted[used])
        return cls(frames, moved + J @ frames)


def _deviations(
    found: _Found,
    shared: _Shared,
    stations: Sequence[Station],
    poses: PoseArrays,
    used: Bool[np.ndarray, " n"],
) -> list[Deviation]:
    """Return every station's deviation, as fitted and held out.

    Without station i the information is C⁻¹ - JᵀV⁻¹J, and to first order its residual (1 - J C JᵀV⁻¹)⁻¹ e.
    """
    e, J = residuals(found.frames, poses), jacobian(found.frames, poses.T_target_camera)
    measured = measurement_covariance(found.frames, poses)
    V = _variances(found.frames, poses, found.robot)
    results = []
    for i, station in enumerate(stations):
        common = J[i] @ found.covariance @ J[i].T
        left = np.eye(6) - (common @ np.linalg.inv(V[i]) if used[i] else 0.0)
        position = rotation = covariance = None
        if float(np.min(np.abs(np.linalg.eigvals(left)))) > 1e-3:
            held_out = np.linalg.solve(left, e[i])
            position, rotation = -held_out[:3], -held_out[3:]
            # J C₋ᵢ Jᵀ = (1 - J C JᵀV⁻¹)⁻¹ J C Jᵀ (Woodbury).
            together = np.linalg.solve(left, shared.attained[i])
            covariance = measured[i] + np.linalg.solve(left, common) + together @ together.T
        results.append(
            Deviation(station.pose_id, -e[i, :3], -e[i, 3:], position, rotation, covariance, bool(used[i]))
        )
    return results


def _remarks(robot: tuple[float, ...], distance: float, wrong: Sequence[str]) -> list[Advisory]:
    found = []
    if wrong:
        found.append(
            Advisory(
                "poses_left_out",
                f"{', '.join(wrong)} lie far from where the other poses say they are and are left out of the tie.",
                "Check their pose_id and commanded values, and that the target's origin is the same in their images.",
            )
        )
    if robot[0] > LARGE_DEVIATION * distance or robot[1] > LARGE_DEVIATION:
        found.append(
            Advisory(
                "deviations_large",
                f"Commanded and measured poses differ by {robot[0]:.3g} mm and {math.degrees(robot[1]):.2g}° (standard "
                "deviation along each axis), which is more than robots are off.",
                "Check the commanded values (millimetres, R = Rz Ry Rx, the same tool for all), the images' pose_id "
                "and the target's pitch.",
            )
        )
    return found
