"""Drift of pose accuracy (ISO 9283:1998, 7.6): how AP changes over blocks of consecutive cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.metrology.accuracy.pose_accuracy import PoseAccuracy

_DRAWS = 10_000


@dataclass(frozen=True, slots=True)
class AccuracyDrift:
    """AP_p of every block, mm, and dAP_p, that of the first block less the last one's, without sign.

    `standard_uncertainty_mm` is of dAP; None where the uncertainty of AP is not known.
    """

    accuracy_mm: tuple[float, ...]
    dap_mm: float
    standard_uncertainty_mm: float | None


def accuracy_drift(
    accuracy: PoseAccuracy,
    positions_mm: Float[np.ndarray, "n 3"],
    rotations: Float[np.ndarray, "n 3 3"] | None,
    blocks: Sequence[tuple[int, int]],
) -> AccuracyDrift | None:
    """Return dAP = |AP_1 - AP_T| of one pose; None where its accuracy does not say in which frames it compared.

    Parameters
    ----------
    accuracy
        AP of the pose, by the mean of all its visits.
    positions_mm, rotations
        Of the visits in their order, as they were measured.
    blocks
        First visit of each block and the one after its last, counted from 0; two visits or more in each.

    A block's deviation is that of the pose, moved by what the block's mean differs from the mean of all visits: the
    frames are tied once. The uncertainty is the standard deviation of draws of both lengths, with one draw of what the
    tie leaves open for both, and of each block's mean by its visits' scatter: the lengths are not linear in it where
    the deviation is not much larger.
    """
    if accuracy.place is None:
        return None
    figures = accuracy.figures
    vector = np.array([figures.x_mm, figures.y_mm, figures.z_mm], dtype=np.float64)
    places = accuracy.place.attained(positions_mm, rotations)
    parts = [places[start:end] for start, end in blocks]
    vectors = [vector + part.mean(axis=0) - places.mean(axis=0) for part in parts]
    lengths = [float(np.linalg.norm(one)) for one in vectors]
    uncertainty = None
    if accuracy.parts is not None:
        deviations = accuracy.parts.draws_without_visits(_DRAWS)
        rng = np.random.default_rng(_DRAWS)
        drawn = []
        for moved, part in ((vectors[0] - vector, parts[0]), (vectors[-1] - vector, parts[-1])):
            scatter = rng.multivariate_normal(moved, np.cov(part.T) / len(part), _DRAWS, method="eigh")
            drawn.append(np.linalg.norm(deviations + scatter, axis=1))
        uncertainty = float(np.std(drawn[0] - drawn[1]))
    return AccuracyDrift(tuple(lengths), abs(lengths[0] - lengths[-1]), uncertainty)
