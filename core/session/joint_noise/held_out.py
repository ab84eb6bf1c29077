"""Joint noise judged at poses that had no part in it: is the scatter there what was predicted?

Poses are dealt into folds; the noise of the others predicts each one's covariance. Two questions are asked. Is the
scatter as large as predicted: the root mean square of the whitened deviations, and of the logarithm of RP_l measured
over RP_l predicted. And is a model of the joints needed: the gain in log-likelihood over two rivals without joints,
fitted to the same others. One is their mean covariance, in whatever direction it lies; the other scatters equally in
all directions. The second has so few parameters that it gains over the first without any joint, and so would joints.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from core.kinematics import (
    JointNoise,
    PoseScatters,
    chi_ratio,
    fit_joint_noise,
    log_likelihood,
    scatter_covariance,
)
from core.metrology import eigenvalues, long_run_rp, position_repeatability, rp_sampling_distribution

MAX_FOLDS = 10
MIN_GAIN = 1.0
"""In standard errors of the gain: of sessions without joint noise 3 to 5 % have more, as a test simulates."""


@dataclass(frozen=True, slots=True)
class HeldOutScatter:
    """Prediction and measurement at held-out poses.

    Parameters
    ----------
    chi_ratio
        Root mean square whitened deviation; 1 where the predicted covariances are right.
    rp_ratio
        RP_l measured over RP_l predicted, of every pose, both with the instrument's noise; the measured one without the
        bias of few cycles; NaN of a pose whose visits the fit excluded.
    rp_log_rms
        Root mean square of its logarithm; `rp_log_expected` is what the number of cycles alone makes of it.
    constant_rp_log_rms
        The same for one covariance for all poses.
    log_likelihood_gain
        Over the rival that predicts better, summed over the poses.
    log_likelihood_gain_standard_error
        From the gains of the single poses, taken as independent.
    """

    chi_ratio: float
    rp_ratio: Float[np.ndarray, " k"]
    rp_log_rms: float
    rp_log_expected: float
    constant_rp_log_rms: float
    log_likelihood_gain: float
    log_likelihood_gain_standard_error: float

    @property
    def supported(self) -> bool:
        """Whether the joints predict held-out poses better than both rivals, by more than chance."""
        return self.log_likelihood_gain > MIN_GAIN * self.log_likelihood_gain_standard_error


def validate_joint_noise(seen: PoseScatters, noise: JointNoise) -> HeldOutScatter:
    """Predict every pose's scatter from the others; the visits that the fit excluded stay excluded."""
    everything = seen.without(noise.outliers)
    counted = np.flatnonzero(everything.visits > 1)
    kept = everything.take(counted)
    k = len(counted)
    folds = min(MAX_FOLDS, k)
    fold = np.arange(k) % folds
    freedom = np.maximum(kept.visits - 1, 0).astype(np.float64)
    scatter = kept.scatter
    predicted, constant, equal = (np.empty_like(scatter) for _ in range(3))
    for part in range(folds):
        held, others = np.flatnonzero(fold == part), np.flatnonzero(fold != part)
        for jacobian, V in ((kept.jacobian, predicted), (np.zeros_like(kept.jacobian), equal)):
            seen_by = replace(kept, jacobian=jacobian)
            theta = fit_joint_noise(seen_by.take(others), rejecting=False).variances
            V[held] = kept.own[held] + scatter_covariance(jacobian[held], theta)
        mean = scatter[others].sum(axis=0) / freedom[others].sum()
        constant[held] = mean + 1e-9 * np.trace(mean) / len(mean) * np.eye(len(mean))
    spectrum = eigenvalues(predicted[:, :3, :3])
    law = rp_sampling_distribution(spectrum, kept.visits.astype(np.float64))
    readings = np.array([_reading(kept, pose) for pose in range(k)])
    unbiased = np.maximum(readings, 1e-12) * np.exp(-law.centre)
    ratio = unbiased / long_run_rp(spectrum)
    of_constant = unbiased / long_run_rp(eigenvalues(constant[:, :3, :3]))
    of_joints, *of_rivals = (log_likelihood(V, scatter, freedom) for V in (predicted, constant, equal))
    gain = of_joints - max(of_rivals, key=np.sum)
    of_all = np.full(len(everything.jacobian), math.nan)
    of_all[counted] = ratio
    return HeldOutScatter(
        chi_ratio(predicted, scatter, freedom),
        of_all,
        _rms_log(ratio),
        math.sqrt(float(np.mean(law.spread**2))),
        _rms_log(of_constant),
        float(gain.sum()),
        float(np.std(gain, ddof=1)) * math.sqrt(k),
    )


def _reading(seen: PoseScatters, pose: int) -> float:
    return float(position_repeatability(seen.deviations[seen.pose == pose, :3]))


def _rms_log(ratio: Float[np.ndarray, " k"]) -> float:
    return math.sqrt(float(np.mean(np.log(ratio) ** 2)))
