"""An identification with the terms beyond the chain: its fit, gauge and validation where they count.

Terms and chain are one linearised problem about the chain's own fit (`error_model`). The chain's parameters, base and
tool move to where that problem puts them, with the covariance that it states. A parameter whose uncertainty is beyond
`MAX_LENGTH_UNCERTAINTY_MM` or `MAX_ANGLE_UNCERTAINTY` is not identifiable: it goes back to its nominal value, and the
others to what they are given that value, with the uncertainty that the nominal's leaves them. Those that the poses
hardly determine, and the chain's fit held, are part of the problem where the nominal is known, with their prior: they
are identifiable where the poses and the others' priors leave at most `MOST_OF_PRIOR` of it.
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
    fit_unweighted,
    frame_errors,
)

MAX_LENGTH_UNCERTAINTY_MM, MAX_ANGLE_UNCERTAINTY = 3.0, math.radians(0.25)
MOST_STEPS = 10
"""From the chain's own fit to one near the nominal; most take two or three."""
MOST_OF_PRIOR = 0.5
"""Of the standard deviation about the nominal: a parameter that is hardly narrower is its prior's, not the poses'."""
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
    free = gauge.free.copy()
    assumed = gauge.assumed if held_at is not None else gauge.assumed[:0]
    free[assumed] = True
    arm = refined.arm
    if held_at is not None:
        # Poses that leave much open lead the chain's own fit far from the nominal: too far to be linear.
        arm = fit_unweighted(arm, kept, free, refined.scatter, MOST_STEPS, held_at)
    problem = design(arm, kept, free, held_at, labels)
    of_fold = _folds(kept, refined, folds, labels)
    blocks = blocks_of(refined.arm, kept.joint_angles, labels) if folds > 1 else {}
    model = choose_model(problem, refined.scatter, of_fold, blocks, always=choice is ModelChoice.EXTENDED)
    counted = model.fit.used[problem.visit]
    used = refined.used.copy()
    used[poses[~counted]] = False
    residuals = refined.residuals.copy()
    residuals[:, poses] = model.residuals()
    step, covariance = model.chain_posterior()
    moved = np.zeros(arm.layout.size)
    moved[problem.free] = step
    fitted = replace(
        refined,
        free=problem.free,
        arm=arm.moved(moved),
        scatter=model.scatter,
        residuals=residuals,
        used=used,
        covariance=covariance,
    )
    values = refined.arm.parameters if held_at is None else held_at
    fitted, gauge = _with_held(fitted, gauge, values, assumed, known=held_at is not None)
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


def _with_held(
    fitted: FitResult,
    gauge: Gauge,
    values: Float[np.ndarray, "j 5"],
    assumed: Int[np.ndarray, " w"],
    *,
    known: bool,
) -> tuple[FitResult, Gauge]:
    """Return the fit with parameters that are too uncertain at the given values, and the others given these; of those
    `assumed` the ones that their prior alone determines. `known` are values of a nominal; others are conventions.
    """
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
    off = np.where(
        of_chain, (values - fitted.arm.parameters).ravel()[np.minimum(columns, values.size - 1)], 0.0
    )
    spread = np.zeros(len(columns))  # about the value that is assumed
    if known:
        spread[of_chain] = layout.nominal_deviations()[columns[of_chain]]
    covariance, step = fitted.covariance.copy(), np.zeros(len(columns))
    given = covariance.copy()  # were the values exact: how the others follow those held
    held: list[int] = []
    is_assumed = np.isin(columns, assumed)
    limit = np.where(is_assumed, MOST_OF_PRIOR * spread, limit)
    while True:
        excess = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / limit
        excess[held] = 0.0
        worst = int(np.argmax(excess))
        if not excess[worst] > 1.0:
            break
        if given[worst, worst] > 0.0:
            gain = given[:, worst] / given[worst, worst]
            step += gain * (off[worst] - step[worst])
            given = given - np.outer(gain, given[worst])
        if not is_assumed[worst]:  # of those assumed the prior is in the covariance
            gain = covariance[:, worst] / (covariance[worst, worst] + spread[worst] ** 2)
            covariance = covariance - np.outer(gain, covariance[worst])
        held.append(worst)
    free = gauge.free.copy()
    free[columns[columns < layout.kinematic]] = True
    free[columns[held]] = False
    hardly = {c: said for c, said in gauge.hardly.items() if c not in columns or not free[c]}
    left = np.delete(np.arange(len(columns)), held)
    move = np.zeros(layout.size)
    move[columns] = step
    everywhere = fitted.free.copy()
    everywhere[columns[held]] = False
    names, keys = layout.names(), layout.keys()
    hardly |= {
        column: Unidentifiable(
            (keys[column],),
            f"{names[column]} is not determined to {MAX_LENGTH_UNCERTAINTY_MM:g} mm or "
            f"{math.degrees(MAX_ANGLE_UNCERTAINTY):g}° by these poses.",
        )
        for column in sorted(columns[held].tolist())
        if column not in hardly
    }
    return (
        replace(
            fitted,
            arm=fitted.arm.moved(move),
            free=everywhere,
            covariance=covariance[np.ix_(left, left)],
        ),
        replace(gauge, free=free, hardly=hardly),
    )
