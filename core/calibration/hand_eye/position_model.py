"""Positions that a point fixed to the camera takes in the robot's base frame, and their derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from core.geometry import hats

MIN_ROTATION = math.radians(0.1)
"""Along an axis about which the camera turned by less, the point is not asked for."""


@dataclass(frozen=True, slots=True)
class PositionState:
    T_base_target: Float[np.ndarray, "4 4"]
    point: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True)
class PositionProblem:
    """`free` (3, k) spans the observable directions of the point, in the camera frame."""

    commanded: Float[np.ndarray, "n 3"]
    measured: Float[np.ndarray, "n 4 4"]
    covariance: Float[np.ndarray, "n 6 6"]
    free: Float[np.ndarray, "3 k"]

    def part(self, used: Bool[np.ndarray, " n"]) -> PositionProblem:
        return PositionProblem(self.commanded[used], self.measured[used], self.covariance[used], self.free)


def observable_directions(rotations: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "3 k"]:
    """Return the directions v of the camera frame for which R_i v differs between poses."""
    spread = (rotations - rotations.mean(axis=0)).reshape(-1, 3)
    _, singular, Vt = np.linalg.svd(spread, full_matrices=False)
    return np.ascontiguousarray(Vt[singular > MIN_ROTATION * math.sqrt(len(rotations))].T)


def predicted(state: PositionState, measured: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 3"]:
    inside = measured[:, :3, 3] + measured[:, :3, :3] @ state.point
    return inside @ state.T_base_target[:3, :3].T + state.T_base_target[:3, 3]


def residuals(state: PositionState, problem: PositionProblem) -> Float[np.ndarray, "n 3"]:
    return problem.commanded - predicted(state, problem.measured)


def jacobian(state: PositionState, problem: PositionProblem) -> Float[np.ndarray, "n 3 p"]:
    """Return the predictions' derivatives by the point along `free`, then by d and w of T_base_target."""
    R = state.T_base_target[:3, :3]
    from_target = predicted(state, problem.measured) - state.T_base_target[:3, 3]
    by_point = R @ problem.measured[:, :3, :3] @ problem.free
    by_place = np.broadcast_to(np.eye(3), (len(by_point), 3, 3))
    return np.concatenate([by_point, by_place, -hats(from_target)], axis=2)


def effect(state: PositionState, problem: PositionProblem) -> Float[np.ndarray, "n 3 6"]:
    """Return what an error of the measured pose does to the prediction."""
    R = state.T_base_target[:3, :3]
    turned = -R @ hats(problem.measured[:, :3, :3] @ state.point)
    return np.concatenate([np.broadcast_to(R, turned.shape), turned], axis=2)


def measurement(state: PositionState, problem: PositionProblem) -> Float[np.ndarray, "n 3 3"]:
    """Return the predictions' covariance due to measurement."""
    G = effect(state, problem)
    return np.asarray(G @ problem.covariance @ G.swapaxes(1, 2))
