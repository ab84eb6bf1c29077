"""Drift of pose accuracy (ISO 9283:1998, 7.6): how AP changes over blocks of consecutive cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from core.metrology.accuracy import PoseAccuracy


@dataclass(frozen=True, slots=True)
class AccuracyDrift:
    """AP_p of every block, mm, and dAP_p, that of the first block less the last one's, without sign.

    `standard_uncertainty_mm` is of dAP; None where the uncertainty of AP is not known, or by two degrees of freedom or
    fewer.
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
    frames are tied once. To first order u² = Σ aᵀC a + dᵀC_t d, a the directions of both deviations, C the covariances
    of the means by their visits' scatter, d the difference of the directions, C_t what the tie leaves open: an error
    that both blocks share counts only as far as their deviations point to different sides.
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
    if accuracy.parts is not None and accuracy.parts.degrees_of_freedom > 2.0:
        first, last = (
            vectors[k] / lengths[k] if lengths[k] > 0.0 else np.zeros(3) for k in (0, len(blocks) - 1)
        )
        freedom = accuracy.parts.degrees_of_freedom
        of_tie = freedom / (freedom - 2.0) * accuracy.parts.of_tie  # the variance of t
        of_tie += accuracy.parts.shared @ accuracy.parts.shared.T
        variance = float((first - last) @ of_tie @ (first - last))
        for direction, part in ((first, parts[0]), (last, parts[-1])):
            variance += float(direction @ np.cov(part.T) @ direction) / len(part)
        uncertainty = float(np.sqrt(max(variance, 0.0)))
    return AccuracyDrift(tuple(lengths), abs(lengths[0] - lengths[-1]), uncertainty)
