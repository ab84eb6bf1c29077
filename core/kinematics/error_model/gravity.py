"""The direction of gravity in the robot's base, by what the weight of its links does to the measured poses.

It is along the base's z axis unless the poses speak strongly for another: of a robot that is mounted on a wall the
levers about the base's z axis explain nothing, and its joints give way to levers about others. Up and down are the
same, since the prior of a coefficient does not mind its sign.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from core.kinematics.error_model.evidence import minus_2_log
from core.kinematics.error_model.fit import ErrorFit, Level
from core.kinematics.error_model.terms import ALONG_Z

ACROSS = tuple(np.array([np.cos(a), np.sin(a), 0.0]) for a in np.radians([0.0, 45.0, 90.0, 135.0]))
"""Directions across the base's z axis. Between two neighbours a lever is a twelfth shorter."""
LEAST_CONFIGURATIONS = 30
MOST_CONFIGURATIONS = 300
STRONG_EVIDENCE = 20.0
"""In -2 log L."""


def likely_gravity(fit: ErrorFit) -> Float[np.ndarray, "3"]:
    """Return the direction of gravity in the base, by all terms with the hyperparameters of a fit along z."""
    members = fit.members
    if len(members) < LEAST_CONFIGURATIONS:
        return ALONG_Z
    some = np.linspace(0, len(members) - 1, min(len(members), MOST_CONFIGURATIONS)).astype(np.intp)
    everything, problem = fit.levels[Level.ALL], fit.design

    def evidence(direction: Float[np.ndarray, "3"]) -> float:
        sums = replace(problem, gravity=direction).sums(members[some], fit.scatter)
        return minus_2_log(Level.ALL.problem(problem, sums), everything.hyperparameters, everything.noise)

    values = [evidence(direction) for direction in ACROSS]
    best = int(np.argmin(values))
    return ACROSS[best] if values[best] < evidence(ALONG_Z) - STRONG_EVIDENCE else ALONG_Z
