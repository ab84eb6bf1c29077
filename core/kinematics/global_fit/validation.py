"""Cross-validation: how well an identified arm predicts poses that were not used to identify it.

Poses are assigned to folds, all poses of one joint configuration to the same fold, so that no repeat of a held-out pose
is fitted. Joint angles may be encoder values, which differ a little at every visit. For each fold the arm is fitted to
the other poses, starting at the fit of all poses, and compared with the fold; so is the nominal chain, of which only
tool and bases are fitted. Errors common to all poses (the lens) are fitted with the other poses and subtracted on both
sides. Poses that the fit of all poses rejects as gross errors are not predicted; `excluded` is their number.

Folds at random leave neighbours of every held-out pose. `BlockErrors` are the same figures for blocks of joint space.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from core.kinematics.arm_model import ArmState
from core.kinematics.global_fit.blocks import Blocking, blocks_of
from core.kinematics.global_fit.fit import fit_unweighted
from core.kinematics.global_fit.joint_configurations import SAME_CONFIGURATION, configurations
from core.kinematics.global_fit.residuals import Observations, linearised
from core.numerics import Variances

FOLDS = 5
_SEED = 9283  # which poses share a fold is a matter of chance, the same at every run


@dataclass(frozen=True, slots=True)
class HoldOutError:
    """Rms distance of positions (mm) and angle of rotations (rad; None for positions alone) from their prediction."""

    position_rms_mm: float
    rotation_rms: float | None


@dataclass(frozen=True, slots=True)
class BlockErrors:
    """Errors at blocks of joint space, each predicted by the poses of all others."""

    blocking: Blocking
    blocks: int
    identified: HoldOutError
    nominal: HoldOutError | None


@dataclass(frozen=True, slots=True)
class Validation:
    """Errors of the identified and the nominal chain at poses that neither was fitted to: `held_out` poses in `folds`
    folds. The fit of all poses rejected `excluded` poses as gross errors; they are not held out. `blocks` are the
    errors at held-out blocks of joint space, empty where poses are too few for them.
    """

    identified: HoldOutError
    nominal: HoldOutError | None
    held_out: int
    folds: int
    excluded: int
    blocks: tuple[BlockErrors, ...] = ()


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
    out. `labels` are the poses' names, if they have any; poses are in the order of measuring.
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
    identified = partial(_refined, arm, free, scatter)
    found = cross_validate(seen, of_fold, identified, compared, excluded)
    if found is None:
        return None
    blocks = []
    for blocking, of_block in blocks_of(arm, seen.joint_angles, labels).items():
        held = cross_validate(seen, of_block, identified, compared, excluded)
        if held is not None:
            blocks.append(BlockErrors(blocking, held.folds, held.identified, held.nominal))
    return replace(found, blocks=tuple(blocks))


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


def frame_errors(
    nominal: ArmState,
    seen: Observations,
    counted: Bool[np.ndarray, " n"],
    of_fold: Int[np.ndarray, " n"],
    free: Bool[np.ndarray, " p"],
    scatter: Variances,
) -> HoldOutError | None:
    """Return the held-out errors, at the poses that count, of a chain of which only base and tool are fitted."""
    of_frames = free.copy()
    of_frames[: nominal.layout.tool.start] = False
    some = np.flatnonzero(counted)
    fitted = partial(_refined, nominal, of_frames, scatter)
    found = cross_validate(seen.take(some), of_fold[some], fitted, None, 0)
    return None if found is None else found.identified


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


def rms(residuals: Float[np.ndarray, "m n"]) -> HoldOutError:
    """Return the rms lengths of residuals."""
    position = math.sqrt(float(np.mean(np.sum(residuals[:3] ** 2, axis=0))))
    rotation = math.sqrt(float(np.mean(np.sum(residuals[3:] ** 2, axis=0)))) if len(residuals) > 3 else None
    return HoldOutError(position, rotation)


def _rms(parts: list[Float[np.ndarray, "m _"]]) -> HoldOutError:
    return rms(np.concatenate(parts, axis=1))
