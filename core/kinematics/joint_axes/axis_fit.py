"""Joint axes from sweeps, with covariance: circle, screw, or combined with the encoder's angles.

Each arc (one sweep on one target) is fitted by itself as the motion of `arc_model`, weighted by the poses' covariances.
Then the quantities that the arcs have in common are estimated:

- The robot's own scatter, and all that a covariance may not know of: variances of position and of rotation, isotropic,
  by restricted maximum likelihood over all arcs (`core.numerics.variance_components`). They enter the weights, and
  the fit is repeated.
- Wrong poses: beyond the distance that one of 100,000 exceeds, of all arcs' poses together.
- The errors λ common to all poses, of unit variance each: with G_a = Σ J'PC and Σ_a the covariance of arc a alone,
  Λ = 1 + Σ_a (F_a - G_a'Σ_a G_a), λ = Λ⁻¹ Σ_a C'P r. Arcs are circles for any lens, which informs λ.

The covariance is carried from the poses to all axes together, pose by pose, so that a home pose that serves several
arcs is counted as the one measurement it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri

from core.errors import Advisory, ArcTooShort, DegenerateGeometry, InvalidArgument, RotationsMissing, listed
from core.kinematics.joint_axes.arc_fit import ArcProblem
from core.kinematics.joint_axes.arc_model import AXIS_PARAMETERS, Motion, linearised, residuals
from core.kinematics.pose_observations import PoseData
from core.kinematics.sweeps import Sweep
from core.numerics import MEDIAN_LENGTH, SMALLEST, Variances, estimate_variances

METHODS = ("cpa", "screw", "combined")
LEAST_ARC = {"cpa": math.radians(60.0), "screw": math.radians(10.0), "combined": math.radians(10.0)}
"""Shorter arcs are rejected: a short piece of a circle does not determine its centre; encoder or rotations do."""
LEAST_POSES = {"cpa": 4, "screw": 3, "combined": 3}
_SHORT = math.radians(0.1)  # an arc of 60° may end a little early
_REJECTED = 1e-5  # share of good poses that may be lost
_PASSES = 8
_MAX_DIRECTION_UNCERTAINTY = (
    0.1  # rad, of an axis that is an answer; covariance by first order means something up to there
)
_SETTLED = 0.01  # relative change of a standard deviation


@dataclass(frozen=True, slots=True)
class ArcFit:
    """One arc's axis, in the frame of the target it was seen on.

    `direction` is of unit length, by the encoder's sense; `point_mm` is the circle's centre: the point of the axis next
    to the pose at the middle of the arc, `radius_mm` from it. `covariance` (6, 6): of the point (mm), then of a small
    rotation w (rad) of the direction, n_true = exp(w) n; nothing is said along the axis. `residuals` are measured -
    fitted: position (mm) and, where used, rotation vector (rad).
    """

    sweep: Sweep
    point_mm: Float[np.ndarray, "3"]
    direction: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "6 6"]
    radius_mm: float
    residuals: Float[np.ndarray, "n m"]
    used: Bool[np.ndarray, " n"]
    motion: Motion


@dataclass(frozen=True, slots=True)
class AxisFits:
    """All arcs' axes.

    `covariance` is that of all arcs together, four numbers each: the point along e1 and e2 (mm), the direction about
    them (rad), with e1, e2 the columns of `bases`.
    """

    arcs: tuple[ArcFit, ...]
    covariance: Float[np.ndarray, "q q"]
    bases: Float[np.ndarray, "a 3 2"]
    scatter_mm: float
    scatter_rad: float | None
    shared: Float[np.ndarray, " k"]
    warnings: tuple[Advisory, ...]

    @property
    def variances(self) -> Variances:
        """Return the scatter as variances."""
        return Variances(self.scatter_mm**2, 1.0 if self.scatter_rad is None else self.scatter_rad**2)


def fit_axes(
    poses: PoseData, sweeps: Sequence[Sweep], method: str = "combined", begin: AxisFits | None = None
) -> AxisFits:
    """Fit the axis of every sweep.

    `method` is "cpa" (circles through positions), "screw" (poses, whatever the encoder says) or "combined" (poses at
    the encoder's angles; of positions alone, positions at the encoder's angles). `begin` are fits of the same sweeps to
    poses that differ little.

    Raises InvalidArgument for another method, RotationsMissing for screws of positions alone, ArcTooShort where no arc
    of a joint is long enough or has poses enough, DegenerateGeometry where positions do not determine an axis,
    NotConverged where a fit does not settle.
    """
    if method not in METHODS:
        raise InvalidArgument(f"There is no method {method!r} here.", f"Use one of {', '.join(METHODS)}.")
    if method == "screw" and poses.rotations is None:
        raise RotationsMissing("The screw method reads axes off rotations, and the poses have none.")
    usable, warnings = _long_enough(sweeps, method)
    arcs = [ArcProblem.prepared(poses, sweep, method) for sweep in usable]
    if begin is None:
        for arc in arcs:
            arc.start()
        variances = _first_variances(arcs, known=poses.covariance is not None)
    else:
        for arc, earlier in zip(arcs, begin.arcs, strict=True):
            arc.resume(earlier.motion, earlier.used)
        variances = begin.variances
    shared = np.zeros(arcs[0].common.shape[2])
    for attempt in range(_PASSES):
        for arc in arcs:
            arc.refine(variances, shared, robust=attempt == 0 and begin is None)
        _reject(arcs)
        for arc in arcs:
            arc.refine(variances, shared, robust=False)
        former, before = variances, shared
        variances = estimate_variances([arc.linear() for arc in arcs], variances)
        shared = _shared(arcs, shared)
        if attempt and variances.near(former, _SETTLED) and np.all(np.abs(shared - before) < 1e-3):
            break
    for arc in arcs:
        arc.refine(variances, shared, robust=False)
    return _summary(poses, arcs, variances, shared, warnings)


def _long_enough(sweeps: Sequence[Sweep], method: str) -> tuple[list[Sweep], tuple[Advisory, ...]]:
    usable, warnings = [], []
    limit, least = LEAST_ARC[method], LEAST_POSES[method]
    for joint in sorted({sweep.joint for sweep in sweeps}):
        of_joint = [sweep for sweep in sweeps if sweep.joint == joint]
        good = [s for s in of_joint if s.arc >= limit - _SHORT and len(s.poses) >= least]
        longest = max(of_joint, key=lambda sweep: sweep.arc)
        if not good:
            raise ArcTooShort(
                f"The longest sweep of joint {joint + 1} is {math.degrees(longest.arc):.1f}° with "
                f"{len(longest.poses)} poses; method {method} needs {math.degrees(limit):.0f}° and {least} poses."
            )
        if len(good) < len(of_joint):
            warnings.append(
                Advisory(
                    "arc_excluded",
                    f"{len(of_joint) - len(good)} of {len(of_joint)} sweeps of joint {joint + 1} are shorter than "
                    f"{math.degrees(limit):.0f}° or have fewer than {least} poses, and were excluded.",
                    f"To have them count, sweep the joint over {math.degrees(limit):.0f}° or more, at {least} poses "
                    "or more.",
                )
            )
        usable += good
    return usable, tuple(warnings)


def _first_variances(arcs: Sequence[ArcProblem], *, known: bool) -> Variances:
    """Return what the robot adds at first: nothing, or where no covariance is known what medians of residuals say."""
    if known:
        return SMALLEST
    off = np.concatenate([residuals(arc.motion, arc.seen) for arc in arcs])
    lengths = np.linalg.norm(off.reshape(len(off), -1, 3), axis=2)
    found = (np.median(lengths, axis=0) / MEDIAN_LENGTH[3]) ** 2
    return Variances(
        max(float(found[0]), SMALLEST.position),
        max(float(found[-1]), SMALLEST.rotation) if len(found) > 1 else SMALLEST.rotation,
    )


def _reject(arcs: Sequence[ArcProblem]) -> None:
    """Mark the poses that count: those within the distance of good ones, in units of the noise that most show."""
    components = arcs[0].seen.components
    distances = [arc.distances() for arc in arcs]
    noise = float(np.median(np.concatenate(distances))) / float(chdtri(components, 0.5))
    limit = max(noise, 1.0) * float(chdtri(components, _REJECTED))
    for arc, squared in zip(arcs, distances, strict=True):
        arc.used = np.asarray(squared <= limit)


def _shared(arcs: Sequence[ArcProblem], before: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Return the errors common to all poses, in their standard deviations."""
    if not len(before):
        return before
    information, weighted = np.eye(len(before)), np.zeros(len(before))
    for arc in arcs:
        r, J, C = arc.whitened()
        kept = C - J @ np.linalg.lstsq(J, C, rcond=None)[0]
        information += kept.T @ kept
        weighted += kept.T @ (r + C @ before)
    return np.linalg.solve(information, weighted)


def _summary(
    poses: PoseData,
    arcs: Sequence[ArcProblem],
    variances: Variances,
    shared: Float[np.ndarray, " k"],
    warnings: tuple[Advisory, ...],
) -> AxisFits:
    """Carry covariance from poses to axes: every estimate is linear in the poses' errors and in the shared ones.

    With K_a the gains of arc a, S_a = K_a C its answer to the shared errors, M the projected derivatives by them and Λ
    their information, the axes' errors are (K - S Λ⁻¹ M) e + S Λ⁻¹ λ.
    """
    count, k, m = AXIS_PARAMETERS * len(arcs), len(shared), arcs[0].own.shape[1]
    gain = np.zeros((count, len(poses), m))
    projected = np.zeros((k, len(poses), m))
    answer = np.zeros((count, k))
    information = np.eye(k)
    for index, arc in enumerate(arcs):
        _, J, W = linearised(arc.motion, arc.seen)
        keep = arc.used
        J, W, members = J[keep], W[keep], arc.sweep.poses[keep]
        C = W @ arc.common[keep]
        flat, C_flat = J.reshape(-1, J.shape[2]), C.reshape(C.shape[0] * C.shape[1], k)
        solve = np.linalg.pinv(flat)
        rows = slice(AXIS_PARAMETERS * index, AXIS_PARAMETERS * (index + 1))
        by_whitened = solve[:AXIS_PARAMETERS].reshape(AXIS_PARAMETERS, len(W), -1)
        gain[rows, members] += np.einsum("anr,nrm->anm", by_whitened, W)
        answer[rows] = solve[:AXIS_PARAMETERS] @ C_flat
        kept = C_flat - flat @ (solve @ C_flat)
        information += kept.T @ kept
        projected[:, members] += np.einsum("nrk,nrm->knm", kept.reshape(C.shape), W)
    S = answer @ np.linalg.inv(information)
    gain -= np.tensordot(S, projected, axes=1)
    V = (np.zeros((len(poses), m, m)) if poses.covariance is None else poses.covariance[:, :m, :m]) + np.diag(
        variances.diagonal(m)
    )
    spread = np.einsum("anm,nmo->ano", gain, V).reshape(count, -1)
    covariance = spread @ gain.reshape(count, -1).T + S @ S.T
    bases = np.array([arc.motion.basis[:, :2] for arc in arcs])
    _require_determined(arcs, covariance)
    found = tuple(
        _fit_of(arc, bases[i], covariance[4 * i : 4 * i + 4, 4 * i : 4 * i + 4]) for i, arc in enumerate(arcs)
    )
    rejected = sorted({int(p) for arc in arcs for p in arc.sweep.poses[~arc.used]})
    if rejected:
        some = listed([poses.label(i) for i in rejected])
        warnings += (
            Advisory(
                "pose_outliers",
                f"{len(rejected)} poses do not lie on their joint's arc and were rejected: {some}.",
                "Check that these poses carry the right joint angles and show the right target.",
            ),
        )
    return AxisFits(
        found,
        covariance,
        bases,
        math.sqrt(variances.position),
        math.sqrt(variances.rotation) if m == 6 else None,
        shared,
        warnings,
    )


def _require_determined(arcs: Sequence[ArcProblem], covariance: Float[np.ndarray, "q q"]) -> None:
    """Raise DegenerateGeometry where an arc hardly determines its axis."""
    uncertainty = np.sqrt(np.diag(covariance)).reshape(-1, AXIS_PARAMETERS)[:, 2:].max(axis=1)
    worst = int(np.argmax(uncertainty))
    if uncertainty[worst] > _MAX_DIRECTION_UNCERTAINTY:
        arc = arcs[worst]
        raise DegenerateGeometry(
            f"The sweep of joint {arc.sweep.joint + 1} leaves the direction of its axis uncertain by "
            f"{math.degrees(uncertainty[worst]):.0f}°: it is {math.degrees(arc.sweep.arc):.0f}° at a radius of "
            f"{arc.motion.radius:.3g} mm.",
            "Mount the camera or reflector away from the joint's axis, or sweep a longer arc; or use rotations "
            "(method screw or combined).",
        )


def _fit_of(arc: ArcProblem, basis: Float[np.ndarray, "3 2"], covariance: Float[np.ndarray, "4 4"]) -> ArcFit:
    spread = np.zeros((6, AXIS_PARAMETERS))
    spread[:3, :2] = spread[3:, 2:] = basis
    return ArcFit(
        arc.sweep,
        arc.motion.point,
        arc.motion.direction,
        spread @ covariance @ spread.T,
        arc.motion.radius,
        residuals(arc.motion, arc.seen),
        arc.used,
        arc.motion,
    )
