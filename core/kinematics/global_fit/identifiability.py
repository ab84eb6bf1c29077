"""Identifiability of an arm's parameters: the null space of the Jacobian, which parameters are held, and why, in words.

A null vector is a change of parameters that moves no pose. For each, one parameter has to be held. The choice is a
convention: θ and d of the first joint (equivalent to the base), all four of the last joint (equivalent to the tool),
then d of joints whose axes are parallel to the next, then any other parameter that takes part. The null space is
computed at the chain with its near-parallel axes made exactly parallel: a parameter that is determined only by the
remaining thousandth of a degree counts as not determined.

In addition to the exact null space, directions that the data hardly determine are held by the same rules: those
uncertain by more than `MAX_RELATIVE_UNCERTAINTY` of the arm's reach. What is held in the exact null space is a
convention. What is held in a weak direction is an assumption: the robot's own value departs from the nominal, and the
other parameters by what they make of it.

References: J. M. Hollerbach, C. W. Wampler, Int. J. Robotics Research 15 (1996) 573-591.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from core.kinematics.arm_model import ALPHA, BETA, THETA, A, ArmState, D, ParameterLayout
from core.kinematics.dh import PARALLEL_AT_MOST, nearly_parallel
from core.kinematics.global_fit.null_space import (
    FixedParameters,
    Unidentifiable,
    unidentifiable,
    weakly_identifiable,
)
from core.kinematics.global_fit.observability import scaled
from core.kinematics.global_fit.residuals import Observations, linearised, whitened, whitener
from core.numerics import Variances

RANK = 1e-8  # of the largest singular value
MIN_SHARE = 1e-3  # of a null vector's length
MAX_RELATIVE_UNCERTAINTY = 0.02
"""Of the reach: a combination of parameters that moves the arm's end by so much within its uncertainty is open."""


@dataclass(frozen=True, slots=True)
class Gauge:
    """Which columns are fitted, and why the others are held.

    `parallel` marks the joints whose axes are near parallel to the next, so that β replaces d. `conventions` are the
    parameters of which one is held by convention, `hardly` the columns that are held because the data hardly determine
    them. `assumed` are those of the joints among the latter, and `by_assumed` what one standard deviation of each about
    the nominal does to the estimates of all columns.
    """

    free: Bool[np.ndarray, " p"]
    parallel: Bool[np.ndarray, " j"]
    conventions: tuple[Unidentifiable, ...]
    hardly: Mapping[int, Unidentifiable]
    assumed: Int[np.ndarray, " w"]
    by_assumed: Float[np.ndarray, "p w"]

    @property
    def unidentifiable(self) -> tuple[Unidentifiable, ...]:
        """The parameters that are not identifiable."""
        return (*self.conventions, *self.hardly.values())


def fix_gauge(
    arm: ArmState, seen: Observations, scatter: Variances, parallel: Bool[np.ndarray, " j"] | None = None
) -> Gauge:
    """Decide at an arm what to fit; joints known to be `parallel` to the next stay so, as do those that have a β."""
    layout = arm.layout
    _, J = linearised(arm, seen)
    information = _scaled_information(arm, seen, J, scatter)
    decided = _parallel(arm, information)
    known = arm.parameters[:, BETA] != 0.0
    known[-1] = False
    if parallel is not None:
        known |= parallel
    # but not where the axes turned out to stand apart
    decided |= known & (np.abs(np.sin(arm.parameters[:, ALPHA])) < PARALLEL_AT_MOST)
    candidates = np.ones(layout.size, dtype=np.bool_)
    for joint in range(layout.joints):
        candidates[layout.column(joint, BETA)] = decided[joint]
    candidates[layout.kinematic :] = False
    for target in range(layout.targets):
        candidates[layout.base(target)] = np.any(seen.target == target)
    columns = np.flatnonzero(candidates)
    snapped = _snapped(arm, decided)
    J = scaled(snapped, linearised(snapped, seen)[1])
    order = [c for c in _order(layout, decided) if candidates[c]]
    exact = _held(null_space(J[columns].reshape(len(columns), -1)), columns, order)
    free = candidates.copy()
    free[exact.columns] = False
    left = np.flatnonzero(free)
    H = _marginal(information, left, layout.kinematic)
    values, vectors = np.linalg.eigh(H)
    weak = _held(
        vectors[:, values < (MAX_RELATIVE_UNCERTAINTY * arm.reach_mm) ** -2.0],
        left,
        [c for c in order if free[c]],
    )
    free[weak.columns] = False
    conventions = tuple(unidentifiable(exact, layout, decided, seen.rotations is None))
    hardly = dict(zip(weak.columns, weakly_identifiable(weak, layout), strict=True))
    assumed = np.array(sorted(c for c in weak.columns if c < layout.tool.start), dtype=np.intp)
    fitted = np.isin(left, np.flatnonzero(free))
    of = np.searchsorted(left, assumed)
    by_assumed = np.zeros((layout.size, len(assumed)))
    units = layout.units(arm.reach_mm)
    by_assumed[left[fitted]] = (
        -units[left[fitted], None]
        * np.linalg.solve(H[np.ix_(fitted, fitted)], H[fitted][:, of])
        * (layout.nominal_deviations()[assumed] / units[assumed])
    )
    return Gauge(free, decided, conventions, hardly, assumed, by_assumed)


def null_space(rows: Float[np.ndarray, "p q"]) -> Float[np.ndarray, "p k"]:
    """Return an orthonormal basis of the combinations of rows that vanish."""
    R = np.linalg.qr(rows.T, mode="r")
    _, values, Vt = np.linalg.svd(R)
    full = np.zeros(len(rows))
    full[: len(values)] = values
    return np.ascontiguousarray(Vt[full <= RANK * values[0]].T)


def _scaled_information(
    arm: ArmState, seen: Observations, J: Float[np.ndarray, "p m n"], scatter: Variances
) -> Float[np.ndarray, "p p"]:
    """Return the whitened information on all columns, in steps of like weight."""
    rows = whitened(whitener(seen, scatter), J * arm.layout.units(arm.reach_mm)[:, None, None])
    rows = rows.reshape(len(J), -1)
    H = rows @ rows.T
    k = arm.layout.kinematic
    H[k:, k:] += np.eye(arm.layout.shared)
    return np.asarray(H)


def _marginal(H: Float[np.ndarray, "p p"], kept: np.ndarray, kinematic: int) -> Float[np.ndarray, "f f"]:
    """Return the information on the columns kept, the shared errors eliminated."""
    kept_part = H[np.ix_(kept, kept)]
    shared = H[kinematic:, kinematic:]
    if not len(shared):
        return kept_part
    C = H[kept, kinematic:]
    return np.asarray(kept_part - C @ np.linalg.solve(shared, C.T))


def _parallel(arm: ArmState, information: Float[np.ndarray, "p p"]) -> Bool[np.ndarray, " j"]:
    """Return which joints' axes are near parallel to the next, by the uncertainty that their d would have."""
    layout = arm.layout
    parallel = np.zeros(layout.joints, dtype=np.bool_)
    alphas = arm.parameters[:-1, ALPHA]
    if not any(nearly_parallel(float(alpha), math.inf) for alpha in alphas):
        return parallel
    last = layout.joints - 1
    held = {layout.column(0, THETA), layout.column(0, D), *(layout.column(last, k) for k in range(5))}
    held |= {layout.column(i, BETA) for i in range(layout.joints)}
    columns = np.array([c for c in range(layout.kinematic) if c not in held])
    values, vectors = np.linalg.eigh(_marginal(information, columns, layout.kinematic))
    half = vectors / np.sqrt(np.maximum(values, 1e-15 * values[-1]))
    sigma = dict(zip(columns.tolist(), np.sqrt(np.sum(half**2, axis=1)).tolist(), strict=True))
    for joint, alpha in enumerate(alphas.tolist()):
        # The first joint's d belongs to the base; the uncertainty appears in the next joint's d.
        shown = layout.column(max(joint, 1), D)
        parallel[joint] = nearly_parallel(alpha, sigma.get(shown, math.inf))
    return parallel


def _snapped(arm: ArmState, parallel: Bool[np.ndarray, " j"]) -> ArmState:
    """Return the arm with its near-parallel axes made parallel."""
    parameters = arm.parameters.copy()
    parameters[parallel, ALPHA] = math.pi * np.round(parameters[parallel, ALPHA] / math.pi)
    parameters[parallel, BETA] = 0.0
    return replace(arm, parameters=parameters)


def _order(layout: ParameterLayout, parallel: Bool[np.ndarray, " j"]) -> Iterator[int]:
    """Return all columns, those first that are held by preference."""
    last = layout.joints - 1
    yield layout.column(0, THETA)
    yield layout.column(0, D)
    yield from (layout.column(last, k) for k in (THETA, D, A, ALPHA, BETA) if last or k not in (THETA, D))
    inner = range(layout.joints - 1)
    yield from (layout.column(i, D) for i in inner if i and parallel[i])
    yield from (layout.column(i, D) for i in inner if i and not parallel[i])
    for parameter in (THETA, BETA, ALPHA, A):
        yield from (layout.column(i, parameter) for i in inner if i or parameter != THETA)
    frames = [layout.tool, *(layout.base(t) for t in range(layout.targets))]
    for frame in frames:
        yield from range(frame.start + 3, frame.stop)
        yield from range(frame.start, frame.start + 3)


def _held(N: Float[np.ndarray, "p k"], columns: np.ndarray, order: Sequence[int]) -> FixedParameters:
    """Choose a column to hold for every null vector, in the order of preference."""
    place = {int(c): i for i, c in enumerate(columns)}
    rest = N.copy()
    chosen: list[int] = []
    for column in order:
        if len(chosen) == N.shape[1]:
            break
        row = rest[place[column]]
        length = float(np.linalg.norm(row))
        if length > MIN_SHARE:
            chosen.append(column)
            rest = rest - np.outer(rest @ row, row) / length**2
    if not chosen:
        return FixedParameters([], [])
    V = N @ np.linalg.pinv(N[[place[c] for c in chosen]])
    vectors = []
    for k in range(len(chosen)):
        v = V[:, k] / np.linalg.norm(V[:, k])
        vectors.append({int(c): float(v[i]) for i, c in enumerate(columns) if abs(v[i]) > MIN_SHARE})
    return FixedParameters(chosen, vectors)
