"""Quantiles of few values, for which numpy's own take ten times as long, and of the normal distribution."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

NORMAL_95 = 1.959964
"""Half the width of a normal figure's 95 % interval, in standard uncertainties."""


def quantiles(values: Float[np.ndarray, " n"], shares: Sequence[float]) -> list[float]:
    """Return numpy's (linear) quantiles of finite values, of which there must be one at least."""
    last = len(values) - 1
    places = [share * last for share in shares]
    below = [int(place) for place in places]
    sorted_there = np.partition(values, sorted({k for low in below for k in (low, min(low + 1, last))}))
    lower = [float(sorted_there[low]) for low in below]
    upper = [float(sorted_there[min(low + 1, last)]) for low in below]
    return [a + (place - low) * (b - a) for a, b, place, low in zip(lower, upper, places, below, strict=True)]


def median(values: Float[np.ndarray, " n"]) -> float:
    """Return the median of finite values, of which there must be one at least."""
    middle = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, middle)[middle])
    low, high = np.partition(values, (middle - 1, middle))[middle - 1 : middle + 1]
    return 0.5 * float(low + high)
