"""Cross-validation: how well an identified arm predicts poses that were not used to identify it.

Poses are assigned to folds, all poses of one joint configuration to the same fold, so that no repeat of a held-out pose
is fitted. Joint angles may be encoder values, which differ a little at every visit. For each fold the arm is fitted to
the other poses, starting at the fit of all poses, and compared with the fold; so is the nominal chain, of which only
tool and bases are fitted. Errors common to all poses (the lens) are fitted with the other poses and subtracted on both
sides. Poses that the fit of all poses rejects as gross errors are not predicted; `excluded` is their number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from core.kinematics.arm_model import ArmState
from core.kinematics.global_fit.fit import fit_unweighted
from core.kinematics.global_fit.residuals import Observations, linearised
from core.numerics import Variances

FOLDS = 5
SAME_CONFIGURATION = math.radians(0.05)
"""Joint angles no further apart are visits to one configuration."""
_SEED = 9283  # which poses share a fold is a matter of chance, the same at every run


@dataclass(frozen=True, slots=True)
class HoldOutError:
    """Rms distance of positions (mm) and angle of rotations (rad; None for positions alone) from their prediction."""

    position_rms_mm: float
    rotation_rms: float | None


@dataclass(frozen=True, slots=True)
class Validation:
    """Errors of the identified and the nominal chain at poses that neither was fitted to: `held_out` poses in `folds`
    folds. The fit of all poses rejected `excluded` poses as gross errors; they are not held out.
    """

    identified: HoldOutError
    nominal: HoldOutError | None
    held_out: int
    folds: int
    excluded: int


Fitted = Callable[[Observations, int], ArmState | None]
"""An arm from the poses that are left without a fold; None where they are too few."""


def validate(
    arm: ArmState,
    nominal: ArmState | None,
    seen: Observations,
    free: Bool[np.ndarray, " p"],
    scatter: Variances,
    folds: int = FOLDS,
    excluded: int = 0,
    labels: Sequence[str] = (),
) -> Validation | None:
    """Return the held-out errors of a fit of all poses at once; None where there are too few configurations to hold any
    out. `labels` are the poses' names, if they have any.
    """
    of_fold = assign_folds(seen.joint_angles, folds, labels)
    least = int(free[: arm.layout.kinematic].sum())
    count = int(of_fold.max()) + 1
    if count < folds or (len(seen) - np.bincount(of_fold).max()) * seen.components < 1.2 * least:
        return None
    of_frames = free.copy()
    of_frames[: arm.layout.tool.start] = False
    compared: Fitted | None = None
    if nominal is not None:
        compared = partial(_refined, nominal, of_frames, scatter)
    return cross_validate(seen, of_fold, partial(_refined, arm, free, scatter), compared, excluded)


def cross_validate(
    seen: Observations,
    of_fold: Int[np.ndarray, " n"],
    identified: Fitted,
    nominal: Fitted | None,
    excluded: int,
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
    return Validation(_rms(found), _rms(compared) if compared else None, taken, count, excluded)


def _refined(
    arm: ArmState, free: Bool[np.ndarray, " p"], scatter: Variances, others: Observations, _: int
) -> ArmState:
    return fit_unweighted(arm, others, free, scatter)


def assign_folds(
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

    Points of one cell of a grid as wide as the tolerance agree, so that repeats, which would make very many pairs of
    points, make few pairs of cells. Two neighbouring cells are linked by their nearest points.
    """
    grid = np.floor((points - points.min(axis=0, initial=0.0)) / tolerance)
    cells, cell = np.unique(grid, axis=0, return_inverse=True)
    cell = cell.ravel()
    members = np.split(np.argsort(cell, kind="stable"), np.cumsum(np.bincount(cell))[:-1])
    pairs = KDTree(cells).query_pairs(1.5, p=np.inf, output_type="ndarray")
    first = np.array([of_cell[0] for of_cell in members])
    near = (
        np.abs(points[first[pairs[:, 0]]] - points[first[pairs[:, 1]]]).max(axis=1, initial=0.0) <= tolerance
    )
    edges = coo_array((np.ones(np.count_nonzero(near)), pairs[near].T), shape=(len(cells), len(cells)))
    _, component = connected_components(edges, directed=False)
    clusters = DisjointSet(range(int(component.max()) + 1))
    several = np.array([len(of_cell) > 1 for of_cell in members])
    for pair in pairs[~near & several[pairs].any(axis=1)]:
        one, other = component[pair].tolist()
        if not clusters.connected(one, other):
            few, many = sorted((points[members[of_pair]] for of_pair in pair), key=len)
            if KDTree(many).query(few, p=np.inf)[0].min() <= tolerance:
                clusters.merge(one, other)
    component = np.array([clusters[one] for one in range(int(component.max()) + 1)])[component]
    _, at_first, of_component = np.unique(component[cell], return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(at_first))[of_component.ravel()])


def rms(residuals: Float[np.ndarray, "m n"]) -> HoldOutError:
    """Return the rms lengths of residuals."""
    position = math.sqrt(float(np.mean(np.sum(residuals[:3] ** 2, axis=0))))
    rotation = math.sqrt(float(np.mean(np.sum(residuals[3:] ** 2, axis=0)))) if len(residuals) > 3 else None
    return HoldOutError(position, rotation)


def _rms(parts: list[Float[np.ndarray, "m _"]]) -> HoldOutError:
    return rms(np.concatenate(parts, axis=1))
