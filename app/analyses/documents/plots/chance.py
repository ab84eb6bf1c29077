"""What chance alone gives where nothing moves: limits that plots draw alongside what was found."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri, ndtri, stdtrit

CHANCE = 0.95
"""Of what chance alone gives lies within the limits."""


def block_limits(
    values: Float[np.ndarray, "n 3"], blocks: Sequence[tuple[int, int]]
) -> Float[np.ndarray, "b 3"]:
    """Return half the width of the limits of each block's mean less the first block's, in the unit of `values`.

    Cycles scatter independently about one mean, by what they scatter within the blocks (start, end); Student's t.
    """
    freedom = sum(end - start - 1 for start, end in blocks)
    if freedom < 1:
        return np.full((len(blocks), 3), np.nan)
    parts = [values[start:end] - values[start:end].mean(axis=0) for start, end in blocks]
    spread = np.sqrt(sum(np.sum(part**2, axis=0) for part in parts) / freedom)
    per_count = np.array([1.0 / (end - start) for start, end in blocks])
    width = np.sqrt(per_count + per_count[0])
    width[0] = 0.0
    return np.asarray(float(stdtrit(freedom, 0.5 + 0.5 * CHANCE)) * np.outer(width, spread))


def trend_limits(values: Float[np.ndarray, "n 3"], at: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3"]:
    """Return half the width of the limits of a straight line's change from the first place to the last, by axis.

    Values scatter independently about one mean; Student's t.
    """
    about = at - at.mean()
    square, freedom = float(about @ about), len(values) - 1
    if square == 0.0 or freedom < 1:
        return np.zeros(3)
    spread = values.std(axis=0, ddof=1)
    return np.asarray(
        float(stdtrit(freedom, 0.5 + 0.5 * CHANCE)) * spread * float(np.ptp(at)) / math.sqrt(square)
    )


def length_limit(half_width: Float[np.ndarray, "3"]) -> float:
    """Return the length below which chance alone leaves a vector whose components have these limits.

    The squared length is a weighted sum of χ²; by F. E. Satterthwaite, Biometrics Bull. 2 (1946) 110-114,
    doi:10.2307/3002019.
    """
    variance = (half_width / float(ndtri(0.5 + 0.5 * CHANCE))) ** 2
    total = float(variance.sum())
    if not total > 0.0:
        return 0.0
    freedom = total**2 / float(variance @ variance)
    return math.sqrt(total / freedom * float(chdtri(freedom, 1.0 - CHANCE)))
