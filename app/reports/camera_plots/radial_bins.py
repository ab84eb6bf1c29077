"""Residuals along the radius in bins, and what the plot of lens models and the camera's figures say of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

BINS, MIN_POINTS_IN_BIN = 24, 8


@dataclass(frozen=True, slots=True)
class RadialResiduals:
    """Residuals of one model's fit along the radius (observed - predicted, outwards positive), and where it turns back.

    `fold_px` is None for a model that does not turn back.
    """

    model: str
    radius_px: Float[np.ndarray, " n"]
    outwards_px: Float[np.ndarray, " n"]
    rms_px: float
    fold_px: float | None


@dataclass(frozen=True, slots=True)
class RadialBins:
    """Mean of the residuals along the radius in bins of equal width, with their standard errors and numbers."""

    middle_px: Float[np.ndarray, " b"]
    mean_px: Float[np.ndarray, " b"]
    error_px: Float[np.ndarray, " b"]
    count: Int[np.ndarray, " b"]


def radial_bins(model: RadialResiduals, reach_px: float) -> RadialBins:
    """Return the bins up to a radius that have points enough."""
    edges = np.linspace(0.0, reach_px * (1.0 + 1e-9), BINS + 1)
    place = np.digitize(model.radius_px, edges) - 1
    rows = []
    for k in range(BINS):
        values = model.outwards_px[place == k]
        if len(values) >= MIN_POINTS_IN_BIN:
            error = float(np.std(values, ddof=1)) / math.sqrt(len(values))
            rows.append((0.5 * float(edges[k] + edges[k + 1]), float(np.mean(values)), error, len(values)))
    middle, mean, errors, count = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    return RadialBins(middle, mean, errors, count.astype(np.intp))
