"""Identified DH parameters compared with those of the arm as built, and what the demo insists on.

A parameter that poses do not determine is a convention: the service keeps the data sheet's value. The arm as built is
restated in the same conventions before the comparison, so that only identifiable parameters count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from app.cli.demo.arm_session import ArmAnswers
from app.cli.demo.evaluation import MAX_RATIO, SIGNIFICANCE, error_ratio, root_mean_square
from app.client import Json
from core.kinematics import reparametrise
from core.simulation import JOINT_REPEATABILITY_RAD, KR5_ARC, Arm, ArmSession, joint_motions

FIELDS = {
    "a": "a_mm",
    "alpha": "alpha_deg",
    "d": "d_mm",
    "theta": "theta_offset_deg",
    "beta": "beta_deg",
}
IDENTIFIABLE = 18
"""Of a six-axis arm with two parallel axes: 24 and a β, less θ1, d1, one d of the parallel pair and the last four."""
MIN_USED_SHARE = 0.95
"""Of the images: all show their grid, and noise alone is seldom taken for an outlier."""
MIN_IMPROVEMENT = 3.0
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


def parameters_with_truth(arm: Arm, answer: Json) -> list[Parameter]:
    """Return every parameter of an answer, joint by joint; β where it is in use."""
    parallel = [joint["parallel_to_next"] for joint in answer["joints"]]
    true = reparametrise(arm.chain, parallel, KR5_ARC).as_array()
    nominal = KR5_ARC.as_array()
    found = []
    for joint, as_built, stated in zip(answer["joints"], true, nominal, strict=True):
        for column, (name, field) in enumerate(FIELDS.items()):
            if joint[field] is None:
                continue
            unit = math.degrees(1.0) if field.endswith("_deg") else 1.0
            known = joint["standard_uncertainty"][field] if joint["identifiable"][field] else None
            found.append(
                Parameter(
                    joint["joint"], name, unit * stated[column], unit * as_built[column], joint[field], known
                )
            )
    return found


def accuracy(parameters: Sequence[Parameter], answer: Json) -> Accuracy:
    """Return how far an answer is from the truth, over the parameters that it identifies."""
    identified = [p for p in parameters if p.uncertainty is not None]
    return Accuracy(
        root_mean_square([p.error for p in identified if not p.is_angle]),
        root_mean_square([p.error for p in identified if p.is_angle]),
        error_over_uncertainty(identified, answer),
    )


def nominal_accuracy(parameters: Sequence[Parameter]) -> Accuracy:
    """Return how far the data sheet is from the truth, over the same parameters."""
    identified = [p for p in parameters if p.uncertainty is not None]
    return Accuracy(
        root_mean_square([p.nominal_error for p in identified if not p.is_angle]),
        root_mean_square([p.nominal_error for p in identified if p.is_angle]),
        None,
    )


def error_over_uncertainty(identified: Sequence[Parameter], answer: Json) -> float:
    """Return sqrt(eᵀ Σ⁻¹ e / n), Σ with the correlations that the answer states: 1 where its uncertainty is right."""
    places = [answer["parameters"].index(f"joint_{p.joint}.{FIELDS[p.name]}") for p in identified]
    correlation = np.array(answer["correlation"])[np.ix_(places, places)]
    z = np.array([p.error / (p.uncertainty or math.nan) for p in identified])
    return error_ratio(z, correlation)


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


def failed_arm_checks(session: ArmSession, answers: ArmAnswers, parameters: Sequence[Parameter]) -> list[str]:
    """Return what is not as it must be, in words; `parameters` are those of method global."""
    found = []
    answer = answers.by_method["global"]
    if not MIN_USED_SHARE * len(session.images) <= poses_used(answer) <= len(session.images):
        found.append(f"{poses_used(answer)} of {len(session.images)} images of the sweeps were used")
    identified = [p for p in parameters if p.uncertainty is not None]
    if len(identified) != IDENTIFIABLE:
        found.append(f"{len(identified)} DH parameters were identified; the poses determine {IDENTIFIABLE}")
    own, sheet = accuracy(parameters, answer), nominal_accuracy(parameters)
    if own.ratio is None or not own.ratio < MAX_RATIO:
        found.append(f"DH parameters are off by {own.ratio:.1f} times what was stated")
    limit = -float(ndtri(SIGNIFICANCE / (2.0 * IDENTIFIABLE)))
    for p in identified:
        if p.uncertainty is not None and not abs(p.error) < limit * p.uncertainty:
            found.append(
                f"{p.name} of joint {p.joint} is {abs(p.error) / p.uncertainty:.1f} of its uncertainties from the truth"
            )
    if not (
        MIN_IMPROVEMENT * own.lengths_mm < sheet.lengths_mm
        and MIN_IMPROVEMENT * own.angles_deg < sheet.angles_deg
    ):
        found.append("the identified robot is hardly nearer the truth than its data sheet")
    held = answer["validation"]
    if held is None or not held["position_rms_mm"] < held["nominal"]["position_rms_mm"]:
        found.append("the identified robot predicts held-out poses no better than its data sheet")
    return found
