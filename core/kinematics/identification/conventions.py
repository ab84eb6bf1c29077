"""An identified arm in the one of its equal descriptions that is reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from core.kinematics.arm_model import THETA, A
from core.kinematics.dh import Chain
from core.kinematics.equal_descriptions import (
    described,
    nearest_description,
    positive_description,
    unwrapped,
)
from core.kinematics.global_fit import FitResult, Gauge, Observations, information_of, linearised
from core.numerics import covariance_of


def in_reported_form(
    refined: FitResult, gauge: Gauge, seen: Observations, nominal: Chain | None
) -> FitResult:
    """Return the fit with its arm as the nominal robot is described; without one with a > 0, or α > 0 where axes meet.

    Jacobian and covariance are those of the description that is returned.
    """
    arm = refined.arm
    links = len(arm.parameters) - 1
    fitted = gauge.free[: arm.parameters.size].reshape(arm.parameters.shape)
    tied = (~fitted[:links, THETA]).tolist()
    tied[:1] = [False] * min(links, 1)  # the base takes the turn
    reference = None if nominal is None else nominal.as_array()
    arm = replace(arm, parameters=unwrapped(arm.parameters, reference))
    if reference is not None:
        reversals = nearest_description(arm.parameters, reference, tied)
    else:
        reversals = positive_description(arm.parameters, _sigma_a(refined), tied)
    if not reversals.any():
        return replace(refined, arm=arm)
    arm = described(arm, reversals, tool_turns=seen.rotations is not None)
    arm = replace(arm, parameters=unwrapped(arm.parameters, reference))
    residuals, jacobian = linearised(arm, seen)
    information = information_of(seen, jacobian, refined.free, refined.used, refined.scatter)
    return replace(
        refined,
        arm=arm,
        residuals=residuals,
        jacobian=jacobian,
        covariance=covariance_of(information),
    )


def _sigma_a(refined: FitResult) -> Float[np.ndarray, " l"]:
    """Return the uncertainty of each a but the last, mm; zero where it is held."""
    layout = refined.arm.layout
    sigma = np.zeros(layout.size)
    sigma[refined.free] = np.sqrt(np.diag(refined.covariance))
    return np.array([sigma[layout.column(i, A)] for i in range(layout.joints - 1)])
