"""What the terms are, joint by joint: curves over the joint's angle, compliance, and where joints have been."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from core.kinematics.error_model.evidence import Fitted
from core.kinematics.error_model.model import ErrorModel
from core.kinematics.error_model.terms import Kind, harmonic_basis

CURVE_STEP = math.radians(2.0)
MAX_GAP = math.radians(10.0)
"""Between neighbouring angles of a joint: predictions inside a wider gap are off by what its curve does there."""

MAX_PRIOR_SHARE = 0.8
"""Of a coefficient's prior variance: what is left of more is not determined by the poses."""
_NO_LEVER = 1e-12
"""Information on a coefficient, per (rad/m)²: a column of zeros but for rounding."""


@dataclass(frozen=True, slots=True)
class JointCurve:
    """What joint `joint` (from 1) turns by beyond its stated angle, over the angles it has been at; all rad."""

    joint: int
    angles: Float[np.ndarray, " a"]
    correction: Float[np.ndarray, " a"]
    standard_uncertainty: Float[np.ndarray, " a"]


@dataclass(frozen=True, slots=True)
class JointCompliance:
    """How far a joint (from 1) gives way to weight: about its own axis z, or across it about x or y of its frame.

    Radians per metre of lever: the moment, about that axis, of a unit weight at the centroid of the arm beyond that
    does to the measured poses what the weights of all links do. The first harmonic of the joint's curve may have a part
    of what its own link's weight does.
    """

    joint: int
    axis: str
    rad_per_m: float
    standard_uncertainty: float


@dataclass(frozen=True, slots=True)
class JointApproach:
    """How far a joint (from 1) stops ahead of the mean of both directions, when it last moved to larger angles, rad;
    behind it after moves to smaller ones. Twice that is its reversal error.
    """

    joint: int
    offset: float
    standard_uncertainty: float


@dataclass(frozen=True, slots=True)
class JointRegion:
    """Where a joint (from 1) has been, rad: from `minimum` to `maximum` but for the gaps wider than 10°."""

    joint: int
    minimum: float
    maximum: float
    gaps: tuple[tuple[float, float], ...]


def joint_curves(model: ErrorModel) -> tuple[JointCurve, ...]:
    """Return the curve of every joint in steps of 2°; none where the model has no curves."""
    problem, fitted = model.fit.design, model.fitted
    if not model.level.chosen(problem.terms)[problem.terms.of(Kind.CURVE)].any():
        return ()
    found = []
    for joint in range(problem.arm.layout.joints):
        q = problem.seen.joint_angles[model.fit.used, joint]
        angles = np.linspace(q.min(), q.max(), 1 + math.ceil(float(np.ptp(q)) / CURVE_STEP))
        basis = harmonic_basis(angles)
        b, C = _of(model, fitted, problem.terms.curve(joint))
        found.append(
            JointCurve(joint + 1, angles, b @ basis, np.sqrt(np.einsum("ha,hg,ga->a", basis, C, basis)))
        )
    return tuple(found)


def visited_angles(model: ErrorModel) -> Float[np.ndarray, "n j"]:
    """Return the joint angles, rad, of the configurations that the model was fitted to."""
    return np.asarray(model.fit.design.seen.joint_angles[model.fit.used])


def joint_compliance(model: ErrorModel) -> tuple[JointCompliance, ...]:
    """Return the compliances that the poses determine, of every joint about its axes z, x and y.

    About z that is the one that does to the measured poses, in least squares, what all levers of the joint do together.
    One whose uncertainty is nearly that of its prior is not among them: the first joint's about a vertical axis, which
    weight does not turn, is an example.
    """
    terms, fitted = model.fit.design.terms, model.fitted
    prior = fitted.hyperparameters.variances(terms)[0]
    chosen = model.level.chosen(terms)
    found = []
    for joint in range(model.fit.design.arm.layout.joints):
        of_joint = (terms.joint == joint) & chosen
        about_z = np.flatnonzero(of_joint & terms.of(Kind.COMPLIANCE, Kind.LINK_COMPLIANCE))
        across = np.flatnonzero(of_joint & terms.of(Kind.RADIAL))
        for axis, columns in zip("zxy", (about_z, across[:1], across[1:]), strict=True):
            weights = _as_the_first(model, columns)
            if weights is None:
                continue
            b, C = _of(model, fitted, columns)
            variance = float(weights @ C @ weights)
            if variance < MAX_PRIOR_SHARE * float(weights**2 @ prior[columns]):
                found.append(JointCompliance(joint + 1, axis, float(weights @ b), math.sqrt(variance)))
    return tuple(found)


def _as_the_first(model: ErrorModel, columns: Int[np.ndarray, " c"]) -> Float[np.ndarray, " c"] | None:
    """Return how much of the first column does to the poses, in least squares, what one of each column does; None where
    the first does nothing.
    """
    if not len(columns):
        return None
    places = int(model.fit.design.free.sum()) + columns
    products = np.tensordot(1.0 / model.fitted.noise, model.fit.sums.normal[:, places[0], places], axes=1)
    return np.asarray(products / products[0]) if products[0] > _NO_LEVER else None


def joint_approach(model: ErrorModel) -> tuple[JointApproach, ...]:
    """Return what the side a joint comes from does, for the joints of which the poses determine it."""
    problem = model.fit.design
    columns = np.flatnonzero(problem.terms.of(Kind.APPROACH) & model.level.chosen(problem.terms))
    prior = model.fitted.hyperparameters.variances(problem.terms)[0][columns]
    b, C = _of(model, model.fitted, columns)
    return tuple(
        JointApproach(int(problem.terms.joint[column]) + 1, float(value), math.sqrt(float(variance)))
        for column, value, variance, before in zip(columns, b, np.diag(C), prior, strict=True)
        if variance < MAX_PRIOR_SHARE * before
    )


def joint_regions(joint_angles: Float[np.ndarray, "n j"]) -> tuple[JointRegion, ...]:
    """Return where each joint has been."""
    found = []
    for joint, q in enumerate(np.sort(joint_angles, axis=0).T):
        wide = np.flatnonzero(np.diff(q) > MAX_GAP)
        gaps = tuple((float(q[i]), float(q[i + 1])) for i in wide)
        found.append(JointRegion(joint + 1, float(q[0]), float(q[-1]), gaps))
    return tuple(found)


def _of(
    model: ErrorModel, fitted: Fitted, columns: np.ndarray
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, "c c"]]:
    places = int(model.fit.design.free.sum()) + columns
    return fitted.coefficients[places], fitted.covariance[np.ix_(places, places)]
