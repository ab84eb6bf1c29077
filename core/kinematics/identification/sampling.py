"""Uncertainty of identified parameters by sampling: poses drawn about the identified arm, each draw identified anew.

The covariance that a fit states is that of its linearised equations. Sampling asks the equations themselves: with the
identified arm taken for the truth, every trial draws the instrument's noise, the robot's scatter and the errors that
all poses share, and fits the same parameters to the poses that follow, at the same weights. It agrees with the stated
covariance where, of every parameter, spread and mean lie within `MAX_DIFFERENCE` of the stated uncertainty and three
standard deviations of what so many trials can show.

References: JCGM 101:2008 (GUM Supplement 1), 5.9; J. Santolaria, M. Ginés, Robotics and Computer-Integrated
Manufacturing 29 (2013) 370-384 (uncertainty of identified kinematic parameters by Monte Carlo).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from core.geometry import rotations_from_vectors, so3_log
from core.kinematics.arm_model import ArmState
from core.kinematics.dh import pose_with_jacobian
from core.kinematics.global_fit import FitResult, Observations, fit_unweighted
from core.numerics import covariance_of, weights

MAX_DIFFERENCE = 0.05
"""Of the stated standard uncertainty: so much an uncertainty itself is never known."""
_ERRORS_OF_SAMPLING = 3.0
_ITERATIONS = 10
_SEED = 101  # an analysis answers the same at every request


@dataclass(frozen=True, slots=True)
class ParameterSampling:
    """What sampling gave for the parameters that were fitted, in the order of `Identification.names`.

    `ratio` is the standard deviation of the trials over the stated standard uncertainty, `shift` their mean less the
    parameter, in stated uncertainties: what the model's curvature does. `joint_ratio` is the root mean square of the
    trials' Mahalanobis distances by the stated covariance, over that of normal errors. `agrees` says which parameters
    agree within `ratio_tolerance` and `shift_tolerance`.
    """

    trials: int
    ratio: Float[np.ndarray, " f"]
    shift: Float[np.ndarray, " f"]
    joint_ratio: float

    @property
    def ratio_tolerance(self) -> float:
        return MAX_DIFFERENCE + _ERRORS_OF_SAMPLING / math.sqrt(2.0 * self.trials)

    @property
    def shift_tolerance(self) -> float:
        return MAX_DIFFERENCE + _ERRORS_OF_SAMPLING / math.sqrt(self.trials)

    @property
    def agrees(self) -> Bool[np.ndarray, " f"]:
        return np.asarray(
            (np.abs(self.ratio - 1.0) <= self.ratio_tolerance) & (np.abs(self.shift) <= self.shift_tolerance)
        )


def sample_parameters(
    refined: FitResult, seen: Observations, free: Bool[np.ndarray, " p"], trials: int
) -> ParameterSampling:
    """Sample the identification of the `free` kinematic columns, and compare with the covariance that the fit states.

    Raises ValueError for fewer than two trials.
    """
    if trials < 2:
        raise ValueError("A spread needs at least two trials.")
    kept = seen.take(np.flatnonzero(refined.used))
    truth = replace(refined.arm, shared=np.zeros(kept.layout.shared))
    columns = np.flatnonzero(free[: truth.layout.kinematic])
    stated = refined.covariance[: len(columns), : len(columns)]
    W = weights(kept.own, refined.scatter)
    end = pose_with_jacobian(
        truth.parameters, kept.joint_angles, truth.T_target_base[kept.target], truth.T_flange_camera
    )[0]
    rng = np.random.default_rng(_SEED)
    off = np.empty((trials, len(columns)))
    for trial in range(trials):
        noise = np.linalg.solve(W, rng.normal(size=(len(kept), kept.components, 1)))[:, :, 0]
        noise = noise + kept.common @ rng.normal(size=kept.layout.shared)
        drawn = replace(
            kept,
            positions_mm=end[:, :3, 3] + noise[:, :3],
            rotations=None
            if kept.rotations is None
            else rotations_from_vectors(noise[:, 3:]) @ end[:, :3, :3],
        )
        off[trial] = _difference(fit_unweighted(truth, drawn, free, refined.scatter, _ITERATIONS), truth)[
            columns
        ]
    u = np.sqrt(np.diag(stated))
    squared = np.einsum("tp,pq,tq->t", off, covariance_of(stated), off)
    return ParameterSampling(
        trials,
        np.std(off, axis=0, ddof=1) / u,
        off.mean(axis=0) / u,
        math.sqrt(float(squared.mean()) / len(columns)),
    )


def _difference(arm: ArmState, truth: ArmState) -> Float[np.ndarray, " p"]:
    """Return the step from the truth to an arm, in the order of the kinematic columns."""
    frames = [(arm.T_flange_camera, truth.T_flange_camera)]
    frames += list(zip(arm.T_target_base, truth.T_target_base, strict=True))
    parts = [(arm.parameters - truth.parameters).ravel()]
    for found, true in frames:
        parts += [found[:3, 3] - true[:3, 3], so3_log(found[:3, :3] @ true[:3, :3].T)]
    return np.concatenate(parts)
