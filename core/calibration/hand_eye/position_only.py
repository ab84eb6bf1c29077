"""Hand-eye calibration from commanded positions alone.

The flange's orientation is unknown, but the camera measures its own. With c the commanded point
(the tool's) in the camera frame, unknown like the target in the base,

    p_base,i = R_base_target (p_i + R_i c) + t_base_target,      (R_i, p_i) = T_target_camera,i,

with nine unknowns and without the robot's orientations. The camera's rotation on the flange stays unknown, so only
position accuracy is determined.

c is observable only through rotation. If all rotations share one axis, c along this axis cannot be separated from
t_base_target. That component is held at zero; attained positions do not depend on it.

References: S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE PAMI 13
(1991) 376-380, 10.1109/34.88573 (the case c = 0).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.calibration.hand_eye.answer_checks import LARGE_DEVIATION
from core.calibration.hand_eye.deviations import held_out_factors
from core.calibration.hand_eye.initialisation import check_rigid
from core.calibration.hand_eye.model import MIN_ROBOT_SIGMAS, whitening
from core.calibration.hand_eye.outlying_poses import most_credible
from core.calibration.hand_eye.position_model import (
    PositionProblem,
    PositionState,
    effect,
    jacobian,
    measurement,
    observable_directions,
    predicted,
    residuals,
)
from core.calibration.hand_eye.position_start import best_start
from core.calibration.hand_eye.result import PositionObservation, ScaleDifference, rejected_poses
from core.calibration.hand_eye.scale_difference import position_scale_difference
from core.errors import Advisory, InvalidArgument, MotionInsufficient, NotConverged
from core.geometry import perturbed
from core.numerics import Fit, LinearResiduals, Variances, estimate_variances, fit

MIN_POSES_TO_REJECT = 6
MAX_UNCERTAINTY = 0.05
"""Largest standard uncertainty (rad) of the target's rotation in the base that is an answer."""


@dataclass(frozen=True, slots=True)
class PositionOnlyCalibration:
    """The target in the base, the commanded point in the camera frame (mm), and their covariance.

    `covariance` (9, 9): the point, then d (mm) and w (rad) of T_base_target, R_true = exp(w) R. `deviations_mm` (n, 3)
    are attained - commanded in the base frame, `held_out_mm` the same with the frames tied by the other stations (None
    where those would not suffice), `used` the stations that tied the frames. `leverage` and `common` are as in
    `PoseResidual`, of positions alone; `robot_position_mm` and `scale` as in `HandEyeCalibration`.
    """

    T_base_target: Float[np.ndarray, "4 4"]
    point_camera_mm: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "9 9"]
    robot_position_mm: float
    degrees_of_freedom: float
    deviations_mm: Float[np.ndarray, "n 3"]
    held_out_mm: tuple[Float[np.ndarray, "3"] | None, ...]
    used: Bool[np.ndarray, " n"]
    warnings: tuple[Advisory, ...]
    leverage: Float[np.ndarray, "n 3 3"]
    common: Float[np.ndarray, "n 3 k"]
    scale: ScaleDifference | None

    def attained(self, T_target_camera: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 3"]:
        """Return where the commanded point was, base frame, mm."""
        return predicted(PositionState(self.T_base_target, self.point_camera_mm), T_target_camera)

    def measurement_effect(self, T_target_camera: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 6"]:
        """Return what an error of a measured pose does to where the commanded point was."""
        state = PositionState(self.T_base_target, self.point_camera_mm)
        one = PositionProblem(np.zeros((1, 3)), T_target_camera[None], np.zeros((1, 6, 6)), np.zeros((3, 0)))
        return np.asarray(effect(state, one)[0])


def calibrate_from_positions(stations: Sequence[PositionObservation]) -> PositionOnlyCalibration:
    """Estimate the target in the base, and the commanded point in the camera frame, from commanded positions.

    Raises InvalidArgument for numbers that are not finite, MotionInsufficient for too few positions or positions on
    one line, NotConverged where nothing explains most positions.
    """
    commanded = np.array([s.position_base_mm for s in stations]).reshape(-1, 3)
    measured = np.array([s.T_target_camera for s in stations]).reshape(-1, 4, 4)
    covariance = np.array([np.zeros((6, 6)) if s.covariance is None else s.covariance for s in stations])
    if not all(np.all(np.isfinite(values)) for values in (commanded, measured, covariance)):
        raise InvalidArgument("Commanded and measured poses must be finite numbers.")
    check_rigid("measured", measured)
    free = observable_directions(measured[:, :3, :3]) if len(stations) else np.zeros((3, 0))
    needed = 3 + (free.shape[1] + 2) // 3
    if len(stations) < needed:
        raise MotionInsufficient(
            f"Tying the frames by positions needs at least {needed} of them here, got {len(stations)}.",
            "Add poses; ten or more that are not on one line are a good number.",
        )
    problem = PositionProblem(commanded, measured, covariance.reshape(-1, 6, 6), free)
    start = best_start(problem)
    everything = np.ones(len(stations), dtype=np.bool_)
    if len(stations) >= MIN_POSES_TO_REJECT:
        typical = float(np.median(np.linalg.norm(residuals(start, problem), axis=1)))
        robust = _fit(start, problem, max(typical, MIN_ROBOT_SIGMAS.deviations[0]), expected=0.2)
        start, used = robust.state, robust.used
    else:
        used = everything
    if int(used.sum()) < max(needed, 0.5 * len(used)):
        raise NotConverged(
            f"Only {int(used.sum())} of {len(used)} positions agree on where the target is.",
            "Check that commanded positions and images belong together.",
        )
    result, deviation = _estimate(start, problem.part(used))
    while (credible := _most_credible(result, problem, deviation, used)) is not None:
        used = used.copy()
        used[credible] = True
        result, deviation = _estimate(result.state, problem.part(used))
    C = _covariance(result, free)
    if result.status == "singular" or not np.trace(C[6:, 6:]) < MAX_UNCERTAINTY**2:
        _check_deviation(commanded[used], deviation)
        raise MotionInsufficient(
            "The commanded positions lie on one line or close together: the target's rotation in the base is not "
            "determined.",
            "Add positions that span an area, better a volume, as wide as the target's distance.",
        )
    if not result.converged:
        raise NotConverged("No target in the base explains the commanded positions.")
    moved = _shared_motions(result.state, problem, stations)
    leverage, common = _follows(result, problem, deviation, used, moved)
    return PositionOnlyCalibration(
        T_base_target=result.state.T_base_target,
        point_camera_mm=result.state.point,
        covariance=C,
        robot_position_mm=deviation,
        degrees_of_freedom=_surplus(problem, used),
        deviations_mm=-residuals(result.state, problem),
        held_out_mm=_held_out(result, problem, deviation, used),
        used=used,
        warnings=_warnings(stations, used),
        leverage=leverage,
        common=common,
        scale=position_scale_difference(result.state, problem.part(used), deviation, moved[used]),
    )


def _check_deviation(commanded: Float[np.ndarray, "n 3"], deviation: float) -> None:
    """Raise NotConverged where deviations too large for a robot leave the frames uncertain, not the positions."""
    _, extents, _ = np.linalg.svd(commanded - commanded.mean(axis=0), full_matrices=False)
    extent, across = (extents[:2] / math.sqrt(len(commanded))).tolist()
    if deviation > LARGE_DEVIATION * extent and LARGE_DEVIATION * extent < MAX_UNCERTAINTY * across:
        raise NotConverged(
            f"Commanded and measured positions differ by {deviation:.3g} mm (standard deviation along each axis): more "
            f"than robots are off over {extent:.3g} mm.",
            "Check that each pose_id has its own commanded position and no two are exchanged, that both are in "
            "millimetres, and that their frames are right-handed.",
        )


def _fit(
    start: PositionState, problem: PositionProblem, deviation: float, *, expected: float
) -> Fit[PositionState]:
    W = whitening(measurement(start, problem) + deviation**2 * np.eye(3))
    size = problem.free.shape[1]

    def evaluate(state: PositionState) -> tuple[Float[np.ndarray, "3 n"], Float[np.ndarray, "p 3 n"]]:
        whitened = np.einsum("nij,nj->ni", W, residuals(state, problem))
        return whitened.T.copy(), np.ascontiguousarray((W @ jacobian(state, problem)).transpose(2, 1, 0))

    def retract(state: PositionState, step: Float[np.ndarray, " p"]) -> PositionState:
        return PositionState(
            perturbed(state.T_base_target, step[size:]), state.point + problem.free @ step[:size]
        )

    return fit(evaluate, retract, start, np.full(len(W), expected), smallest_scale=expected)


def _estimate(start: PositionState, problem: PositionProblem) -> tuple[Fit[PositionState], float]:
    """Fit, with the robot's deviation estimated from the residuals."""
    rms = math.sqrt(float(np.mean(residuals(start, problem) ** 2)))
    deviation = max(rms, MIN_ROBOT_SIGMAS.deviations[0])
    result = _fit(start, problem, deviation, expected=1.0)
    for _ in range(5):
        former, state = deviation, result.state
        left = LinearResiduals(
            measurement(state, problem), residuals(state, problem), jacobian(state, problem)
        )
        start_at = Variances.of_deviations(deviation, MIN_ROBOT_SIGMAS.deviations[1])
        deviation = estimate_variances([left], start_at, MIN_ROBOT_SIGMAS).deviations[0]
        result = _fit(state, problem, deviation, expected=1.0)
        if abs(deviation - former) < 1e-2 * former:
            break
    return result, deviation


def _surplus(problem: PositionProblem, used: Bool[np.ndarray, " n"]) -> float:
    return max(3.0 * float(used.sum()) - 6.0 - problem.free.shape[1], 1.0)


def _most_credible(
    result: Fit[PositionState], problem: PositionProblem, deviation: float, used: Bool[np.ndarray, " n"]
) -> int | None:
    """Return the station not used that may be one of the others, or None."""
    if np.all(used):
        return None
    J = jacobian(result.state, problem)
    V = (
        measurement(result.state, problem)
        + deviation**2 * np.eye(3)
        + J @ result.covariance @ J.swapaxes(1, 2)
    )
    return most_credible(residuals(result.state, problem)[:, None], V[:, None], used, _surplus(problem, used))


def _shared_motions(
    state: PositionState, problem: PositionProblem, stations: Sequence[PositionObservation]
) -> Float[np.ndarray, "n 3 k"]:
    """Return what one standard uncertainty of each error that all stations share does to the predictions."""
    given = [s.common for s in stations if s.common is not None]
    if len(given) < len(stations):
        return np.zeros((len(stations), 3, 0))
    if len({c.shape[1] for c in given}) > 1:
        raise InvalidArgument("All stations must share the same errors, or none.")
    return np.asarray(effect(state, problem) @ np.array(given))


def _follows(
    result: Fit[PositionState],
    problem: PositionProblem,
    deviation: float,
    used: Bool[np.ndarray, " n"],
    moved: Float[np.ndarray, "n 3 k"],
) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "n 3 k"]]:
    """Return what the frames follow of each station's deviation, and what `moved` leaves in it, common to all."""
    J = jacobian(result.state, problem)
    weights = np.linalg.inv(measurement(result.state, problem) + deviation**2 * np.eye(3))
    leverage = J @ result.covariance @ J.swapaxes(1, 2) @ weights
    frames = -result.covariance @ np.einsum("nij,nik->jk", J[used], (weights @ moved)[used])
    return leverage, moved + J @ frames


def _held_out(
    result: Fit[PositionState], problem: PositionProblem, deviation: float, used: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "3"] | None, ...]:
    """Return attained - commanded with the frames estimated from the other stations."""
    fitted = -residuals(result.state, problem)
    V = measurement(result.state, problem) + deviation**2 * np.eye(3)
    lefts = held_out_factors(jacobian(result.state, problem), result.covariance, V, used)
    return tuple(
        None if left is None else np.linalg.solve(left, e) for left, e in zip(lefts, fitted, strict=True)
    )


def _covariance(result: Fit[PositionState], free: Float[np.ndarray, "3 k"]) -> Float[np.ndarray, "9 9"]:
    size = free.shape[1]
    spread = np.zeros((9, size + 6))
    spread[:3, :size] = free
    spread[3:, size:] = np.eye(6)
    return np.asarray(spread @ result.covariance @ spread.T)


def _warnings(stations: Sequence[PositionObservation], used: Bool[np.ndarray, " n"]) -> tuple[Advisory, ...]:
    wrong = [s.pose_id for s, believed in zip(stations, used, strict=True) if not believed]
    return rejected_poses(wrong)
