"""Tying frames where only positions were commanded.

Nothing says how the flange was turned, but the camera measures how it was turned itself. With c the commanded point
(the tool's) in the camera frame, unknown like the target in the base,

    p_base,i = R_base_target (p_i + R_i c) + t_base_target,      (R_i, p_i) = T_target_camera,i,

which is nine unknowns and needs no orientation of the robot's. Their price: the camera's rotation on the flange stays
unknown, so accuracy is told of positions alone.

c is told by turning: along an axis about which all rotations were it cannot be told from t_base_target. There it is
held at zero and named in `undetermined`; attained positions do not depend on it.

References: S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE PAMI 13
(1991) 376-380, 10.1109/34.88573 (the case c = 0).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from jaxtyping import Bool, Float
from scipy import stats

from core.calibration.hand_eye.model import SMALLEST_POSITION_MM, hats, variance_components, whitening
from core.calibration.hand_eye.start import check_rigid
from core.errors import Advisory, InvalidArgument, MotionInsufficient, NotConverged
from core.least_squares import Fit, fit
from core.transforms import nearest_rotation, so3_exp, transform

LEAST_TO_JUDGE = 6
LEAST_ROTATION = math.radians(0.1)
"""Along an axis about which the camera turned by less, the point is not asked for."""
LARGEST_DOUBT = 0.05
"""Largest standard uncertainty (rad) of the target's rotation in the base that is an answer."""
_TURNS = [
    np.array([np.eye(3)[i] * s for i, s in zip(order, signs, strict=True)])
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]
_CUBE = [R for R in _TURNS if np.linalg.det(R) > 0]


@dataclass(frozen=True, slots=True)
class PositionStation:
    """One commanded position (mm, base frame), and where the camera was measured to be then; else as `Station`."""

    pose_id: str
    position_base_mm: Float[np.ndarray, "3"]
    T_target_camera: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"] | None = None


@dataclass(frozen=True, slots=True)
class PositionTie:
    """The target in the base, the commanded point in the camera frame (mm), and their covariance.

    `covariance` (9, 9): the point, then d (mm) and w (rad) of T_base_target, R_true = exp(w) R. `deviations_mm` (n, 3)
    are attained - commanded in the base frame, `held_out_mm` the same with the frames tied by the other stations (None
    where those would not suffice), `used` the stations that tied the frames; `undetermined` names in words what was
    held.
    """

    T_base_target: Float[np.ndarray, "4 4"]
    point_camera_mm: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "9 9"]
    robot_position_mm: float
    degrees_of_freedom: float
    pose_ids: tuple[str, ...]
    deviations_mm: Float[np.ndarray, "n 3"]
    held_out_mm: tuple[Float[np.ndarray, "3"] | None, ...]
    used: Bool[np.ndarray, " n"]
    undetermined: tuple[str, ...]
    warnings: tuple[Advisory, ...]

    @property
    def coverage_factor(self) -> float:
        """Half a 95 % interval in standard uncertainties."""
        return float(stats.t.ppf(0.975, self.degrees_of_freedom))

    def attained(self, T_target_camera: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 3"]:
        """Return where the commanded point was, base frame, mm."""
        return _predicted(_State(self.T_base_target, self.point_camera_mm), T_target_camera)


@dataclass(frozen=True, slots=True)
class _State:
    T_base_target: Float[np.ndarray, "4 4"]
    point: Float[np.ndarray, "3"]


def tie_positions(stations: Sequence[PositionStation]) -> PositionTie:
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
    free = _told_by_turning(measured[:, :3, :3]) if len(stations) else np.zeros((3, 0))
    needed = 3 + (free.shape[1] + 2) // 3
    if len(stations) < needed:
        raise MotionInsufficient(
            f"Tying the frames by positions needs at least {needed} of them here, got {len(stations)}.",
            "Add poses; ten or more that are not on one line are a good number.",
        )
    problem = _Problem(commanded, measured, covariance.reshape(-1, 6, 6), free)
    start = _start(problem)
    everything = np.ones(len(stations), dtype=np.bool_)
    if len(stations) >= LEAST_TO_JUDGE:
        typical = float(np.median(np.linalg.norm(_residuals(start, problem), axis=1)))
        robust = _fit(start, problem, max(typical, SMALLEST_POSITION_MM), expected=0.2)
        start, used = robust.state, robust.used
    else:
        used = everything
    if int(used.sum()) < max(needed, 0.5 * len(used)):
        raise NotConverged(
            f"Only {int(used.sum())} of {len(used)} positions agree on where the target is.",
            "Check that commanded positions and images belong together.",
        )
    part = problem.part(used)
    result, deviation = _estimate(start, part)
    C = _covariance(result, free)
    if result.status == "singular" or not np.trace(C[6:, 6:]) < LARGEST_DOUBT**2:
        raise MotionInsufficient(
            "The commanded positions lie on one line or close together: the target's rotation in the base is not "
            "determined.",
            "Add positions that span an area, better a volume, as wide as the target's distance.",
        )
    if not result.converged:
        raise NotConverged("No target in the base explains the commanded positions.")
    return PositionTie(
        T_base_target=result.state.T_base_target,
        point_camera_mm=result.state.point,
        covariance=C,
        robot_position_mm=deviation,
        degrees_of_freedom=max(3.0 * float(used.sum()) - 6.0 - free.shape[1], 1.0),
        pose_ids=tuple(s.pose_id for s in stations),
        deviations_mm=-_residuals(result.state, problem),
        held_out_mm=_held_out(result, problem, deviation, used),
        used=used,
        undetermined=_words(free),
        warnings=_remarks(stations, used),
    )


@dataclass(frozen=True, slots=True)
class _Problem:
    """`free` (3, k) spans the directions of the camera frame in which the point can be told."""

    commanded: Float[np.ndarray, "n 3"]
    measured: Float[np.ndarray, "n 4 4"]
    covariance: Float[np.ndarray, "n 6 6"]
    free: Float[np.ndarray, "3 k"]

    def part(self, used: Bool[np.ndarray, " n"]) -> _Problem:
        return _Problem(self.commanded[used], self.measured[used], self.covariance[used], self.free)


def _told_by_turning(rotations: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "3 k"]:
    """Return the directions v of the camera frame for which R_i v differs between poses."""
    spread = (rotations - rotations.mean(axis=0)).reshape(-1, 3)
    _, singular, Vt = np.linalg.svd(spread, full_matrices=False)
    return np.ascontiguousarray(Vt[singular > LEAST_ROTATION * math.sqrt(len(rotations))].T)


def _predicted(state: _State, measured: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 3"]:
    inside = measured[:, :3, 3] + measured[:, :3, :3] @ state.point
    return inside @ state.T_base_target[:3, :3].T + state.T_base_target[:3, 3]


def _residuals(state: _State, problem: _Problem) -> Float[np.ndarray, "n 3"]:
    return problem.commanded - _predicted(state, problem.measured)


def _jacobian(state: _State, problem: _Problem) -> Float[np.ndarray, "n 3 p"]:
    """Return the predictions' derivatives by the point along `free`, then by d and w of T_base_target."""
    R = state.T_base_target[:3, :3]
    from_target = _predicted(state, problem.measured) - state.T_base_target[:3, 3]
    by_point = R @ problem.measured[:, :3, :3] @ problem.free
    by_place = np.broadcast_to(np.eye(3), (len(by_point), 3, 3))
    return np.concatenate([by_point, by_place, -hats(from_target)], axis=2)


def _measurement(state: _State, problem: _Problem) -> Float[np.ndarray, "n 3 3"]:
    """Return the predictions' covariance due to measurement."""
    R = state.T_base_target[:3, :3]
    turned = -R @ hats(problem.measured[:, :3, :3] @ state.point)
    G = np.concatenate([np.broadcast_to(R, turned.shape), turned], axis=2)
    return np.asarray(G @ problem.covariance @ G.swapaxes(1, 2))


def _fit(start: _State, problem: _Problem, deviation: float, *, expected: float) -> Fit[_State]:
    W = whitening(_measurement(start, problem) + deviation**2 * np.eye(3))
    size = problem.free.shape[1]

    def evaluate(state: _State) -> tuple[Float[np.ndarray, "3 n"], Float[np.ndarray, "p 3 n"]]:
        whitened = np.einsum("nij,nj->ni", W, _residuals(state, problem))
        return whitened.T.copy(), np.ascontiguousarray((W @ _jacobian(state, problem)).transpose(2, 1, 0))

    def retract(state: _State, step: Float[np.ndarray, " p"]) -> _State:
        T, rest = state.T_base_target, step[size:]
        moved = transform(so3_exp(rest[3:]) @ T[:3, :3], T[:3, 3] + rest[:3])
        return _State(moved, state.point + problem.free @ step[:size])

    return fit(evaluate, retract, start, np.full(len(W), expected), smallest_scale=expected)


def _estimate(start: _State, problem: _Problem) -> tuple[Fit[_State], float]:
    """Fit, with the robot's deviation estimated from the residuals."""
    rms = math.sqrt(float(np.mean(_residuals(start, problem) ** 2)))
    deviation = max(rms, SMALLEST_POSITION_MM)
    result = _fit(start, problem, deviation, expected=1.0)
    for _ in range(5):
        former, state = deviation, result.state
        (deviation,) = variance_components(
            _residuals(state, problem),
            _jacobian(state, problem),
            _measurement(state, problem),
            (deviation,),
            (SMALLEST_POSITION_MM,),
        )
        result = _fit(state, problem, deviation, expected=1.0)
        if abs(deviation - former) < 1e-2 * former:
            break
    return result, deviation


def _start(problem: _Problem) -> _State:
    """Return the best of some rotations, each with the point and place that suit it by linear least squares.

    The rotations are that of the rigid alignment with the point in the camera's centre, which is near where the point
    is near, and the 24 of a cube; each is improved by the same alignment, with the point known, a few times.
    """
    best, least = None, math.inf
    origin = _State(np.eye(4), np.zeros(3))
    for R in [_aligned(origin, problem), *_CUBE]:
        state = _State(transform(R, np.zeros(3)), np.zeros(3))
        for _ in range(10):
            state = _placed(state.T_base_target[:3, :3], problem)
            state = _State(transform(_aligned(state, problem), np.zeros(3)), state.point)
        state = _placed(state.T_base_target[:3, :3], problem)
        cost = float(np.median(np.linalg.norm(_residuals(state, problem), axis=1)))
        if best is None or cost < least:
            best, least = state, cost
    assert best is not None
    return best


def _aligned(state: _State, problem: _Problem) -> Float[np.ndarray, "3 3"]:
    """Return the rotation that best turns the points in the target frame to the commanded ones."""
    inside = problem.measured[:, :3, 3] + problem.measured[:, :3, :3] @ state.point
    commanded = problem.commanded
    return nearest_rotation((commanded - commanded.mean(axis=0)).T @ (inside - inside.mean(axis=0)))


def _placed(R: Float[np.ndarray, "3 3"], problem: _Problem) -> _State:
    """Return the state of this rotation with the point and the place of least squares."""
    size = problem.free.shape[1]
    by_point = R @ problem.measured[:, :3, :3] @ problem.free
    A = np.concatenate([by_point, np.broadcast_to(np.eye(3), (len(by_point), 3, 3))], axis=2)
    b = problem.commanded - problem.measured[:, :3, 3] @ R.T
    found = np.linalg.lstsq(A.reshape(-1, size + 3), b.ravel(), rcond=None)[0]
    return _State(transform(R, found[size:]), problem.free @ found[:size])


def _held_out(
    result: Fit[_State], problem: _Problem, deviation: float, used: Bool[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "3"] | None, ...]:
    """Return attained - commanded with the frames tied by the others: (1 - J C JᵀV⁻¹)⁻¹ of what is fitted."""
    fitted = -_residuals(result.state, problem)
    found: list[Float[np.ndarray, "3"] | None] = list(fitted)
    J = _jacobian(result.state, problem)
    V = _measurement(result.state, problem) + deviation**2 * np.eye(3)
    for i in np.flatnonzero(used):
        left = np.eye(3) - J[i] @ result.covariance @ J[i].T @ np.linalg.inv(V[i])
        enough = float(np.min(np.abs(np.linalg.eigvals(left)))) > 1e-3
        found[i] = np.linalg.solve(left, fitted[i]) if enough else None
    return tuple(found)


def _covariance(result: Fit[_State], free: Float[np.ndarray, "3 k"]) -> Float[np.ndarray, "9 9"]:
    size = free.shape[1]
    spread = np.zeros((9, size + 6))
    spread[:3, :size] = free
    spread[3:, size:] = np.eye(6)
    return np.asarray(spread @ result.covariance @ spread.T)


def _words(free: Float[np.ndarray, "3 k"]) -> tuple[str, ...]:
    if free.shape[1] == 3:
        return ()
    if free.shape[1] == 0:
        where = "in any direction"
    else:
        axes = np.linalg.svd(free)[0][:, free.shape[1] :].T
        where = "along " + ", ".join(f"({', '.join(f'{v:.2f}' for v in axis)})" for axis in axes)
    return (
        f"the commanded point in the camera frame {where}: the camera was not turned so that it would show",
    )


def _remarks(stations: Sequence[PositionStation], used: Bool[np.ndarray, " n"]) -> tuple[Advisory, ...]:
    wrong = [s.pose_id for s, believed in zip(stations, used, strict=True) if not believed]
    if not wrong:
        return ()
    return (
        Advisory(
            "poses_left_out",
            f"{', '.join(wrong)} lie far from where the other poses say they are and are left out of the tie.",
            "Check their pose_id and commanded values, and that the target's origin is the same in their images.",
        ),
    )
