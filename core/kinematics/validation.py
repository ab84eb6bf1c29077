"""Held-out validation: how well an identified arm predicts poses that had no part in its identification.

Poses are dealt into folds, all poses of one joint configuration into the same, so that no repeat tells of the one held
out; joint angles may be encoder readings, which differ a little at every visit. For each fold the arm is fitted to the
rest, begun at the fit of all (its minimum is its own), and compared with the fold; the nominal chain likewise, with
only its tool and bases fitted. What all poses share (the lens) is fitted with the rest and taken off both sides. Poses
that the fit of all leaves out as gross errors are not predicted, which is said with the figures: `left_out`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from core.kinematics.parameters import ArmState
from core.kinematics.problem import Observations, Scatter, linearised
from core.kinematics.refinement import refine_plainly

FOLDS = 5
SAME_CONFIGURATION = math.radians(0.05)
"""Joint angles no further apart are visits to one configuration."""
_SEED = 9283  # which poses share a fold is a matter of chance, the same at every run


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Rms distance of positions (mm) and angle of rotations (rad; None for positions alone) from their prediction."""

    position_rms_mm: float
    rotation_rms: float | None


@dataclass(frozen=True, slots=True)
class Validation:
    """Identified and nominal chain on poses that neither was fitted to; `held_out` poses in `folds` parts, without the
    `left_out` ones that the fit of all poses has for gross errors.
    """

    identified: HeldOut
    nominal: HeldOut | None
    held_out: int
    folds: int
    left_out: int


Fitted = Callable[[Observations, int], ArmState | None]
"""An arm from the poses that are left without a fold; None where they are too few."""


def validate(
    arm: ArmState,
    nominal: ArmState | None,
    seen: Observations,
    free: Bool[np.ndarray, " p"],
    scatter: Scatter,
    folds: int = FOLDS,
    left_out: int = 0,
    labels: Sequence[str] = (),
) -> Validation | None:
    """Return the held-out errors of a fit of all poses at once; None where there are too few configurations to hold any
    out. `labels` are the poses' names, if they have any.
    """
    of_fold = deal(seen.joint_angles, folds, labels)
    least = int(free[: arm.layout.kinematic].sum())
    count = int(of_fold.max()) + 1
    if count < folds or (len(seen) - np.bincount(of_fold).max()) * seen.components < 1.2 * least:
        return None
    of_frames = free.copy()
    of_frames[: arm.layout.tool.start] = False
    compared: Fitted | None = None
    if nominal is not None:
        compared = partial(_refined, nominal, of_frames, scatter)
    return hold_out(seen, of_fold, partial(_refined, arm, free, scatter), compared, left_out)


def hold_out(
    seen: Observations,
    of_fold: Int[np.ndarray, " n"],
    identified: Fitted,
    nominal: Fitted | None,
    left_out: int,
) -> Validation | None:
    """Return how well what is fitted without a fold predicts it, over all folds; None where one cannot be fitted."""
    found: list[Float[np.ndarray, "m _"]] = []
    compared: list[Float[np.ndarray, "m _"]] = []
    count = int(of_fold.max()) + 1
    for fold in range(count):
        rest, held = np.flatnonzero(of_fold != fold), np.flatnonzero(of_fold == fold)
        held = held[np.isin(seen.target[held], seen.target[rest])]
        if not len(held):
            continue
        others, out = seen.take(rest), seen.take(held)
        for fitted, residuals in ((identified, found), (nominal, compared)):
            if fitted is None:
                continue
            arm = fitted(others, fold)
            if arm is None:
                return None
            residuals.append(linearised(arm, out)[0])
    if not found:
        return None
    taken = sum(part.shape[1] for part in found)
    return Validation(_rms(found), _rms(compared) if compared else None, taken, count, left_out)


def _refined(
    arm: ArmState, free: Bool[np.ndarray, " p"], scatter: Scatter, others: Observations, _: int
) -> ArmState:
    return refine_plainly(arm, others, free, scatter)


def deal(
    joint_angles: Float[np.ndarray, "n j"],
    folds: int,
    labels: Sequence[str] = (),
    tolerance: float = SAME_CONFIGURATION,
) -> Int[np.ndarray, " n"]:
    """Return the fold of every pose, those of one configuration together; arguments as of `configurations`."""
    configuration = configurations(joint_angles, labels, tolerance)
    dealt = np.arange(int(configuration.max()) + 1) % folds
    return np.asarray(np.random.default_rng(_SEED).permutation(dealt)[configuration])


def configurations(
    joint_angles: Float[np.ndarray, "n j"],
    labels: Sequence[str] = (),
    tolerance: float = SAME_CONFIGURATION,
) -> Int[np.ndarray, " n"]:
    """Return the configuration of every pose, counted from 0 in the order of joint angles.

    Poses are of one configuration where none of their joints differs by more than `tolerance` (rad), where they have
    the same label, and where a chain of such poses leads from one to the other: single linkage, which has no borders
    for repeats to fall on either side of.
    """
    distinct, at = np.unique(joint_angles, axis=0, return_inverse=True)
    near = _linked(distinct, tolerance)[at.ravel()]
    if labels:
        _, named = np.unique(np.asarray(labels), return_inverse=True)
        count = int(near.max()) + 1
        size = count + int(named.max()) + 1
        edges = coo_array((np.ones(len(near)), (near, count + named.ravel())), shape=(size, size))
        _, component = connected_components(edges, directed=False)
        # Counted by the first of their joint angles, whatever the names are.
        _, first, of_component = np.unique(component[:count], return_index=True, return_inverse=True)
        near = np.argsort(np.argsort(first))[of_component.ravel()][near]
    return np.asarray(near)


def _linked(points: Float[np.ndarray, "n j"], tolerance: float) -> Int[np.ndarray, " n"]:
    """Return the cluster of every point, counted by the first point of each.

    Each is grown by what is left, so that no list of pairs is made: many repeats have very many.
    """
    cluster = np.empty(len(points), dtype=np.intp)
    left, count = np.arange(len(points)), 0
    while len(left):
        growing, left = [int(left[0])], left[1:]
        while growing:
            one = growing.pop()
            cluster[one] = count
            near = np.abs(points[left] - points[one]).max(axis=1, initial=0.0) <= tolerance
            growing += left[near].tolist()
            left = left[~near]
        count += 1
    return cluster


def rms(residuals: Float[np.ndarray, "m n"]) -> HeldOut:
    """Return the rms lengths of residuals."""
    position = math.sqrt(float(np.mean(np.sum(residuals[:3] ** 2, axis=0))))
    rotation = math.sqrt(float(np.mean(np.sum(residuals[3:] ** 2, axis=0)))) if len(residuals) > 3 else None
    return HeldOut(position, rotation)


def _rms(parts: list[Float[np.ndarray, "m _"]]) -> HeldOut:
    return rms(np.concatenate(parts, axis=1))
