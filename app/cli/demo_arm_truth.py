"""Identified DH parameters beside those of the arm as built, and what the demo insists on.

What poses cannot tell is a convention: the service keeps the data sheet's value. The arm as built is described by the
same conventions before it is compared, so that only what can be told counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from app.agent import Json
from app.cli.demo_arm import ArmAnswers
from app.cli.demo_truth import CHANCE, HONEST_BELOW, root_mean_square
from core.kinematics.common_normals import restate
from core.simulation.arm import KR5_ARC, Arm, joint_motions
from core.simulation.arm_session import ArmSession
from core.simulation.experiment import JOINT_REPEATABILITY_RAD

FIELDS = {
    "a": "a_mm",
    "alpha": "alpha_deg",
    "d": "d_mm",
    "theta": "theta_offset_deg",
    "beta": "beta_deg",
}
_WORDS = {"a": "a{}", "alpha": "alpha{}", "d": "d{}", "theta": "theta{} offset", "beta": "beta{}"}
TOLD = 18
"""Of a six-axis arm with two parallel axes: 24 and a β, less θ1, d1, one d of the parallel pair and the last four."""
LEAST_USED = 0.95
"""Of the images: all show their grid, and noise alone is seldom taken for an outlier."""
NEARER = 3.0
"""An identification is to be so many times nearer the truth than the data sheet."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One DH parameter of one joint, mm or °. Without an uncertainty it is a convention, at the data sheet's value."""

    joint: int
    name: str
    nominal: float
    true: float
    identified: float
    uncertainty: float | None

    @property
    def is_angle(self) -> bool:
        return FIELDS[self.name].endswith("_deg")

    @property
    def error(self) -> float:
        return self._from_truth(self.identified)

    @property
    def nominal_error(self) -> float:
        return self._from_truth(self.nominal)

    def _from_truth(self, value: float) -> float:
        return math.remainder(value - self.true, 360.0) if self.is_angle else value - self.true


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How far parameters are from the truth: root mean squares, and the errors over their stated uncertainty."""

    lengths_mm: float
    angles_deg: float
    ratio: float | None


def parameters_beside_truth(arm: Arm, answer: Json) -> list[Parameter]:
    """Return every parameter of an answer, joint by joint; β where it is in use."""
    parallel = [joint["parallel_to_next"] for joint in answer["joints"]]
    true = restate(arm.chain, parallel, KR5_ARC).as_array()
    nominal = KR5_ARC.as_array()
    found = []
    for joint, as_built, told in zip(answer["joints"], true, nominal, strict=True):
        for column, (name, field) in enumerate(FIELDS.items()):
            if joint[field] is None:
                continue
            unit = math.degrees(1.0) if field.endswith("_deg") else 1.0
            known = joint["standard_uncertainty"][field] if joint["identifiable"][field] else None
            found.append(
                Parameter(
                    joint["joint"], name, unit * told[column], unit * as_built[column], joint[field], known
                )
            )
    return found


def accuracy(parameters: Sequence[Parameter], answer: Json) -> Accuracy:
    """Return how far an answer is from the truth, over what it tells."""
    told = [p for p in parameters if p.uncertainty is not None]
    return Accuracy(
        root_mean_square([p.error for p in told if not p.is_angle]),
        root_mean_square([p.error for p in told if p.is_angle]),
        error_over_uncertainty(told, answer),
    )


def nominal_accuracy(parameters: Sequence[Parameter]) -> Accuracy:
    """Return how far the data sheet is from the truth, over the same parameters."""
    told = [p for p in parameters if p.uncertainty is not None]
    return Accuracy(
        root_mean_square([p.nominal_error for p in told if not p.is_angle]),
        root_mean_square([p.nominal_error for p in told if p.is_angle]),
        None,
    )


def error_over_uncertainty(told: Sequence[Parameter], answer: Json) -> float:
    """Return sqrt(eᵀ Σ⁻¹ e / n), Σ with the correlations that the answer states: 1 where its doubt is honest."""
    places = [answer["parameters"].index(_WORDS[p.name].format(p.joint)) for p in told]
    correlation = np.array(answer["correlation"])[np.ix_(places, places)]
    z = np.array([p.error / (p.uncertainty or math.nan) for p in told])
    return math.sqrt(float(z @ np.linalg.solve(correlation, z)) / len(z))


def true_scatter_mm(session: ArmSession) -> float:
    """Return the standard deviation, a coordinate, of where the camera comes back to: what the joints' makes of it."""
    variances = []
    for pose in session.poses:
        _, motions = joint_motions(session.arm, pose.joint_angles, pose.target)
        variances.append(float(np.mean(np.sum(motions[:3] ** 2, axis=1))))
    return JOINT_REPEATABILITY_RAD * math.sqrt(float(np.mean(variances)))


def poses_used(answer: Json) -> int:
    """Return how many poses an answer of method global rests on."""
    return int(answer["joints"][0]["poses"])


def arm_faults(session: ArmSession, answers: ArmAnswers, parameters: Sequence[Parameter]) -> list[str]:
    """Return what is not as it must be, in words; `parameters` are those of method global."""
    found = []
    answer = answers.by_method["global"]
    if not LEAST_USED * len(session.images) <= poses_used(answer) <= len(session.images):
        found.append(f"{poses_used(answer)} of {len(session.images)} images of the sweeps were used")
    told = [p for p in parameters if p.uncertainty is not None]
    if len(told) != TOLD:
        found.append(f"{len(told)} DH parameters were told, where the poses tell {TOLD}")
    own, sheet = accuracy(parameters, answer), nominal_accuracy(parameters)
    if own.ratio is None or not own.ratio < HONEST_BELOW:
        found.append(f"DH parameters are off by {own.ratio:.1f} times what was stated")
    limit = float(norm.isf(CHANCE / (2.0 * TOLD)))
    for p in told:
        if p.uncertainty is not None and not abs(p.error) < limit * p.uncertainty:
            found.append(
                f"{p.name} of joint {p.joint} is {abs(p.error) / p.uncertainty:.1f} of its uncertainties from the truth"
            )
    if not (NEARER * own.lengths_mm < sheet.lengths_mm and NEARER * own.angles_deg < sheet.angles_deg):
        found.append("the identified robot is hardly nearer the truth than its data sheet")
    held = answer["validation"]
    if held is None or not held["position_rms_mm"] < held["nominal"]["position_rms_mm"]:
        found.append("the identified robot predicts held-out poses no better than its data sheet")
    return found
