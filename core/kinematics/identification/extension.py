"""An identification with the terms beyond the chain: its fit, gauge and validation where they count.

Terms and chain are one linearised problem about the chain's own fit (`error_model`). The chain's parameters, base and
tool move to where that problem puts them, with the covariance that it states. A parameter whose uncertainty is beyond
`MAX_LENGTH_UNCERTAINTY_MM` or `MAX_ANGLE_UNCERTAINTY` is not identifiable: it goes back to its nominal value, and the
others to what they are given that value.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Float, Int

from core.kinematics.arm_model import ArmState
from core.kinematics.dh import JOINT_PARAMETERS, Chain
from core.kinematics.error_model import ErrorModel, choose_model, design
from core.kinematics.global_fit import (
    BlockErrors,
    FitResult,
    Gauge,
    Observations,
    Unidentifiable,
    Validation,
    assign_folds,
    blocks_of,
    frame_errors,
)
from core.numerics import covariance_of

MAX_LENGTH_UNCERTAINTY_MM, MAX_ANGLE_UNCERTAINTY = 3.0, math.radians(0.25)
MIN_FOLD_SHARE = 1.2
"""Of the unknowns of the chain: fewer equations without a fold determine nothing."""


class ModelChoice(StrEnum):
    """Which terms an identification has: the chain alone, all terms, or what the poses speak for."""

    AUTO = "auto"
    DH = "dh"
    EXTENDED = "extended"


@dataclass(frozen=True, slots=True)
class Extension:
    """The fit and the gauge in the place of the chain's own, the model, and its validation."""

    refined: FitResult
    gauge: Gauge
    model: ErrorModel
    validation: Validation | None


def extend(
    refined: FitResult,
    gauge: Gauge,
    seen: Observations,
    nominal: Chain | None,
    compared: ArmState | None,
    folds: int,
    labels: Sequence[str],
    choice: ModelChoice,
) -> Extension:
    """Fit the terms to the poses that the chain's fit used.

    `compared` is the nominal robot at its best base and tool; `labels` are those of the poses that were used.

    Raises LinAlgError where the poses leave the columns dependent.
    """
    poses = np.flatnonzero(refined.used)
    kept = seen.take(poses)
    held_at = None if nominal is None else nominal.as_array()
    problem = design(refined.arm, kept, gauge.free, held_at, labels)
    of_fold = _folds(kept, refined, folds, labels)
    blocks = blocks_of(refined.arm, kept.joint_angles, labels) if folds > 1 else {}
    model = choose_model(problem, refined.scatter, of_fold, blocks, always=choice is ModelChoice.EXTENDED)
    counted = model.fit.used[problem.visit]
    used = refined.used.copy()
    used[poses[~counted]] = False
    residuals = refined.residuals.copy()
    residuals[:, poses] = model.residuals()
    step, covariance = model.chain_posterior()
    moved = np.zeros(refined.arm.layout.size)
    moved[problem.free] = step
    fitted = replace(
        refined,
        arm=refined.arm.moved(moved),
        scatter=model.scatter,
        residuals=residuals,
        used=used,
        information=covariance_of(covariance),
        covariance=covariance,
    )
    fitted, gauge = _with_held(fitted, gauge, refined.arm.parameters if held_at is None else held_at)
    validation = None
    if of_fold is not None:
        assignments = {"random": of_fold} | {str(name): block for name, block in blocks.items()}
        nominals = {}
        if compared is not None:
            nominals = {
                name: frame_errors(compared, kept, counted, block, gauge.free, refined.scatter)
                for name, block in assignments.items()
            }
        validation = Validation(
            model.held_out["random"],
            nominals.get("random"),
            int(counted.sum()),
            folds,
            len(seen) - int(counted.sum()),
            tuple(
                BlockErrors(name, int(block.max()) + 1, model.held_out[name], nominals.get(str(name)))
                for name, block in blocks.items()
            ),
        )
    return Extension(fitted, gauge, model, validation)


def _folds(
    seen: Observations, refined: FitResult, folds: int, labels: Sequence[str]
) -> Int[np.ndarray, " n"] | None:
    """Return the folds dealt at random; None where what is without one does not determine the chain."""
    if folds < 2:
        return None
    of_fold = assign_folds(seen.joint_angles, folds, labels)
    unknown = int(refined.free[: refined.arm.layout.kinematic].sum())
    left = (len(seen) - int(np.bincount(of_fold).max())) * seen.components
    return of_fold if int(of_fold.max()) + 1 == folds and left >= MIN_FOLD_SHARE * unknown else None


def _with_held(fitted: FitResult, gauge: Gauge, values: Float[np.ndarray, "j 5"]) -> tuple[FitResult, Gauge]:
    """Return the fit with parameters that are too uncertain at the given values, the others given these."""
    layout = fitted.arm.layout
    columns = np.flatnonzero(fitted.free)
    limits = np.array(
        [
            MAX_ANGLE_UNCERTAINTY if name.endswith("_rad") else MAX_LENGTH_UNCERTAINTY_MM
            for name in JOINT_PARAMETERS
        ]
    )
    of_chain = columns < layout.tool.start
    limit = np.where(of_chain, limits[columns % len(limits)], np.inf)
    covariance, step = fitted.covariance.copy(), np.zeros(len(columns))
    off = np.where(
        of_chain, (values - fitted.arm.parameters).ravel()[np.minimum(columns, values.size - 1)], 0.0
    )
    held: list[int] = []
    while True:
        excess = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / limit
        worst = int(np.argmax(excess))
        if not excess[worst] > 1.0:
            break
        gain = covariance[:, worst] / covariance[worst, worst]
        step += gain * (off[worst] - step[worst])
        covariance = covariance - np.outer(gain, covariance[worst])
        covariance[worst] = covariance[:, worst] = 0.0
        held.append(worst)
    if not held:
        return fitted, gauge
    free = gauge.free.copy()
    free[columns[held]] = False
    left = np.delete(np.arange(len(columns)), held)
    move = np.zeros(layout.size)
    move[columns] = step
    everywhere = fitted.free.copy()
    everywhere[columns[held]] = False
    names, keys = layout.names(), layout.keys()
    said = tuple(
        Unidentifiable(
            (keys[column],),
            f"{names[column]} is not determined to {MAX_LENGTH_UNCERTAINTY_MM:g} mm or "
            f"{math.degrees(MAX_ANGLE_UNCERTAINTY):g}° by these poses.",
        )
        for column in sorted(columns[held].tolist())
    )
    return (
        replace(
            fitted,
            arm=fitted.arm.moved(move),
            free=everywhere,
            information=covariance_of(covariance[np.ix_(left, left)]),
            covariance=covariance[np.ix_(left, left)],
        ),
        replace(gauge, free=free, unidentifiable=(*gauge.unidentifiable, *said)),
    )
