"""Held-out validation: how well an identified arm predicts poses that had no part in its identification.

Poses are dealt into folds, all poses of one joint configuration into the same, so that no repeat tells of the one held
out. For each fold the arm is fitted to the rest, begun at the fit of all (its minimum is its own), and compared with
the fold; the nominal chain likewise, with only its tool and bases fitted. What all poses share (the lens) is fitted
with the rest and taken off both sides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from core.kinematics.parameters import ArmState
from core.kinematics.problem import Observations, Scatter, linearised
from core.kinematics.refinement import refine_plainly

FOLDS = 5
SAME_CONFIGURATION = math.radians(0.05)
_SEED = 9283  # which poses share a fold is a matter of chance, the same at every run


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Rms distance of positions (mm) and angle of rotations (rad; None for positions alone) from their prediction."""

    position_rms_mm: float
    rotation_rms: float | None


@dataclass(frozen=True, slots=True)
class Validation:
    """Identified and nominal chain on poses that neither was fitted to; `held_out` poses in `folds` parts."""

    identified: HeldOut
    nominal: HeldOut | None
    held_out: int
    folds: int


def validate(
    arm: ArmState,
    nominal: ArmState | None,
    seen: Observations,
    free: Bool[np.ndarray, " p"],
    scatter: Scatter,
    folds: int = FOLDS,
) -> Validation | None:
    """Return the held-out errors; None where there are too few configurations to hold any out."""
    of_fold = deal(seen.joint_angles, folds)
    least = int(free[: arm.layout.kinematic].sum())
    count = int(of_fold.max()) + 1
    sizes = np.bincount(of_fold, minlength=count)
    if count < folds or (len(seen) - sizes.max()) * seen.components < 1.2 * least:
        return None
    of_frames = free.copy()
    of_frames[: arm.layout.tool.start] = False
    identified, compared, taken = [], [], 0
    for fold in range(count):
        rest, held = np.flatnonzero(of_fold != fold), np.flatnonzero(of_fold == fold)
        held = held[np.isin(seen.target[held], seen.target[rest])]
        if not len(held):
            continue
        taken += len(held)
        others, out = seen.take(rest), seen.take(held)
        identified.append(linearised(refine_plainly(arm, others, free, scatter), out)[0])
        if nominal is not None:
            compared.append(linearised(refine_plainly(nominal, others, of_frames, scatter), out)[0])
    if not identified:
        return None
    return Validation(_rms(identified), _rms(compared) if compared else None, taken, count)


def deal(joint_angles: Float[np.ndarray, "n j"], folds: int) -> Int[np.ndarray, " n"]:
    """Return the fold of every pose, those of one configuration together."""
    cells = np.round(joint_angles / SAME_CONFIGURATION).astype(np.int64)
    _, configuration = np.unique(cells, axis=0, return_inverse=True)
    configuration = configuration.ravel()
    dealt = np.arange(int(configuration.max()) + 1) % folds
    return np.asarray(np.random.default_rng(_SEED).permutation(dealt)[configuration])


def rms(residuals: Float[np.ndarray, "m n"]) -> HeldOut:
    """Return the rms lengths of residuals."""
    position = math.sqrt(float(np.mean(np.sum(residuals[:3] ** 2, axis=0))))
    rotation = math.sqrt(float(np.mean(np.sum(residuals[3:] ** 2, axis=0)))) if len(residuals) > 3 else None
    return HeldOut(position, rotation)


def _rms(parts: list[Float[np.ndarray, "m _"]]) -> HeldOut:
    return rms(np.concatenate(parts, axis=1))
